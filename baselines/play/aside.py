"""Long work in a process of its own, asked after now and then, so that a window stays alive meanwhile."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from baselines.jobs.apart import end_with_parent, in_one_line
from retract_env.threads import single_threaded

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Tell = Callable[[Any], None]
Work = Callable[[Any, Tell], Any]
"""A function of a module, from what can be pickled to plain data; it tells how far it is."""


@dataclass(frozen=True)
class Said:
    """What was heard of the work."""

    kind: str
    """"progress", "done" or "failed" """
    value: Any = None
    """plain data; one line where it failed"""


class Aside:
    """One piece of work at a time; the process begins early and stays for the next one.

    Whoever makes one closes it. Work that nobody wants any more is ended with its process.
    """

    def __init__(self, nice: int = 0):
        """nice: how far the process stands back behind others, as of `os.nice`."""
        self._nice = nice
        self._process: Any = None
        self._connection: Connection | None = None
        self.busy = False

    def start(self) -> None:
        """Begin the process, which imports what it needs while nobody waits. Does nothing where it runs."""
        if self._process is not None:
            return
        spawn = multiprocessing.get_context("spawn")
        self._connection, there = spawn.Pipe()
        self._process = spawn.Process(target=_serve, args=(there, self._nice), daemon=True, name="aside")
        with single_threaded():
            self._process.start()
        there.close()

    def ask(self, work: Work, argument: Any) -> None:
        """Begin the work; what was under way is ended and never heard of."""
        if self.busy:
            self.close()
        self.start()
        assert self._connection is not None
        self.busy = True
        with suppress(BrokenPipeError):  # it has died, which `poll` tells
            self._connection.send((work, argument))

    def poll(self) -> list[Said]:
        """What has been said since the last call; never waits."""
        said: list[Said] = []
        while self.busy:
            assert self._connection is not None
            try:
                if not self._connection.poll():
                    break
                said.append(Said(*self._connection.recv()))
            except (EOFError, OSError):
                said.append(Said("failed", "the process that computed it has died"))
                self.close()
            if said[-1].kind != "progress":
                self.busy = False
        return said

    def close(self) -> None:
        """End the process, whatever it was at; again does no harm."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
        if self._connection is not None:
            self._connection.close()
        self._process = self._connection = None
        self.busy = False


def _serve(connection: Connection, nice: int) -> None:
    """In the process: do what is asked for, until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is its parent's affair
    end_with_parent()
    if nice and hasattr(os, "nice"):
        os.nice(nice)
    import planners  # noqa: F401  (all that the work needs, while nobody waits)

    while True:
        try:
            work, argument = connection.recv()
        except EOFError:
            return
        try:
            answer = "done", work(argument, lambda value: connection.send(("progress", value)))
        except Exception as error:
            answer = "failed", in_one_line(error)
        connection.send(answer)
