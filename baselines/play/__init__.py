"""Retraction by hand: a person moves the jaws in a window, and the finite elements judge what came of it."""
