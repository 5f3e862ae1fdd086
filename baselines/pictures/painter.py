"""A process of its own that draws the pictures of a plan.

Matplotlib takes most of a second to import, and as long again until it has drawn for the first time. The
painter does both while the plan is made; then it draws the picture and the film at the same time.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from types import SimpleNamespace, TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from baselines.pictures.stiffness import StiffnessCurve
    from planners.base import Plan


class Painter:
    """Context manager: the process starts at once and is gone at the end, whatever it was at.

    Where it cannot be started or dies, or drawing fails in it, the pictures are drawn in this process, which
    raises what there is to raise.
    """

    def __init__(self) -> None:
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; from baselines.pictures.painter import serve; serve()"
        )
        self._process: subprocess.Popen[bytes] | None = None
        # Ctrl-C is for the process that waits, so that this one is out of the terminal's reach.
        apart: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        # NumPy starts threads where it is not told otherwise, and a process with threads is not copied well.
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        with suppress(OSError):
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=environment,
                **apart,
            )

    def __enter__(self) -> Painter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None
        with suppress(OSError):  # it may have ended by itself
            if sys.platform == "win32":
                process.kill()
            else:
                os.killpg(process.pid, signal.SIGKILL)  # with the copy that draws beside it
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):  # what could not be sent is lost
                pipe.close()
        process.wait()

    def begin(self, plan: Plan, names: Sequence[str]) -> Callable[[], dict[str, bytes]]:
        """Have the files of these names drawn; the function that is returned waits for their content."""
        from baselines.pictures.stiffness import stiffness_curve

        curve = stiffness_curve(plan)
        if self._process is not None:
            assert self._process.stdin is not None
            with suppress(OSError):  # it is gone, which is noticed below
                _Plain(self._process.stdin, pickle.HIGHEST_PROTOCOL).dump((plan, curve, list(names)))
                self._process.stdin.flush()

        def drawn() -> dict[str, bytes]:
            if self._process is not None:
                assert self._process.stdout is not None
                with suppress(EOFError, pickle.UnpicklingError):
                    return dict(pickle.load(self._process.stdout))
            return {name: draw(plan, name, curve) for name in names}

        return drawn


class _Plain(pickle.Pickler):
    """What planners define becomes a plain holder of its fields: pictures need no more, and the painter need
    not import the planners, which takes a second."""

    def reducer_override(self, value: Any) -> Any:
        if type(value).__module__.partition(".")[0] == "planners":
            return SimpleNamespace, (), vars(value)
        return NotImplemented


def draw(plan: Plan, name: str, curve: StiffnessCurve | None = None) -> bytes:
    """The content of the picture, or of the film where the name does not end in .png."""
    from baselines.pictures.film import film
    from baselines.pictures.still import picture

    return picture(plan, curve) if name.endswith(".png") else film(plan, name.rpartition(".")[2])


def serve() -> None:
    """The painter's side: get ready, wait for a plan, answer with its pictures."""
    gc.disable()  # it lives too shortly
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library may print does not belong in an answer
    _get_ready()
    try:
        plan, curve, names = pickle.load(sys.stdin.buffer)
        waiting = [_beside(partial(draw, plan, name, curve)) for name in names[1:]]
        drawn = [draw(plan, name, curve) for name in names[:1]] + [wait() for wait in waiting]
        pickle.dump(dict(zip(names, drawn, strict=True)), answers)
        answers.flush()
    except Exception:  # the process that asked draws itself then, and tells what is wrong
        os._exit(1)
    os._exit(0)


def _get_ready() -> None:
    """Import all that draws, and let Matplotlib find its fonts."""
    import io

    import matplotlib
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    import baselines.pictures.film  # noqa: F401  (with all that draws)
    from baselines.pictures.drawing import STYLE

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(1, 1))
        figure.colorbar(ScalarMappable(), cax=figure.add_axes((0.1, 0.1, 0.2, 0.8)), label="strain")
        for weight in ("normal", "bold"):
            figure.text(0.5, 0.5, "grasp", weight=weight)
        for kind in ("png", "gif"):
            figure.savefig(io.BytesIO(), format=kind)


def _beside(work: Callable[[], bytes]) -> Callable[[], bytes]:
    """Begin the work in a copy of this process; the function that is returned waits for its result.

    Elsewhere than on Linux libraries may not outlive being copied: the work is done when it is asked for.
    """
    if sys.platform != "linux":
        return work
    reader, writer = os.pipe()
    if os.fork() == 0:
        try:
            with open(writer, "wb") as pipe:
                pipe.write(work())
        finally:
            os._exit(0)
    os.close(writer)

    def result() -> bytes:
        with open(reader, "rb") as pipe:
            data = pipe.read()
        if not data:
            raise EOFError("the copy has failed")
        return data

    return result
