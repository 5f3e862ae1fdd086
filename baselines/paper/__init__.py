"""The paper's figures and our own studies, repeated by `retract reproduce`."""
