"""Every exception that crosses a package, in one place."""

from __future__ import annotations


class ConfigError(ValueError):
    """Values that cannot be used; the message is one line."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.splitlines()))


class SceneError(ConfigError):
    """A scene that cannot be used; the message is one line."""


class MeshError(ValueError):
    """The section could not be meshed."""


class FlapRefused(MeshError):
    """The flap is more than this physics takes, wherever it is grasped."""


class Diverged(ArithmeticError):
    """No equilibrium was found."""


class NotPositiveDefinite(ArithmeticError):
    """The matrix has no Cholesky factorisation."""
