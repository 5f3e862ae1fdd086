"""Retraction by hand: a person moves the jaws in a window, and the finite elements judge what came of it."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # pygame prints a line as it is imported
