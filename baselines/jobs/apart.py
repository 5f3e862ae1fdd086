"""Work in a process of its own, which may raise, hang or die without harm to whoever asked for it.

What goes there is a function of a module and its argument; what comes back is plain data, as JSON: nothing
that is made there is run here.
"""

from __future__ import annotations

import json
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from retract_env.errors import ConfigError
from retract_env.threads import single_threaded

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from typing_extensions import Self

STARTING = 300.0
"""s, at most, until a process has begun: an interpreter and what the work imports, on a busy machine."""
LOOK = 1.0
"""s between looks at whether a process still lives, which what it began may hide: it holds the same pipes."""
LONGEST_WORD = 300
"""characters of an exception's text"""


class ApartError(ConfigError):
    """A process that could not be begun: the machine's trouble, not the work's. The message is one line."""


@dataclass(frozen=True)
class Answer:
    """What became of a piece of work."""

    value: Any = None
    """plain data, where it was done"""
    trouble: str = ""
    """"raised", "time" or "died", where it was not"""
    detail: str = ""
    """what exactly, in one line"""


class Apart:
    """A process for one piece of work after the other; one that hung or died is replaced for the next.

    It begins when it is first needed. Whoever makes one closes it, or uses it as a context manager.
    """

    def __init__(self, silent: bool = False, may_fork: bool = False):
        """silent: what is written to the console there is dropped; may_fork: the work may begin processes of
        its own. A process that may not ends with the interpreter by itself."""
        self.silent, self.may_fork = silent, may_fork
        self._process: Any = None
        self._connection: Connection | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def call(self, function: Callable[[Any], Any], argument: Any, limit: float) -> Answer:
        """function: of a module, from what can be pickled to plain data; limit: s. Raises ApartError."""
        try:
            if self._process is not None and not self._process.is_alive():
                self.close()  # it died with nothing to do: of no work's doing
            if self._process is None:
                self._start()
            assert self._connection is not None
            with suppress(BrokenPipeError):  # it has died since
                self._connection.send((function, argument))
            return self._answer(limit)
        except BaseException:  # an interrupt: what goes on there has no reader any more
            self.close()
            raise

    def close(self) -> None:
        """End the process, and those that it began, which outlive it where it died."""
        if self._process is not None:
            if self._process.pid is not None:  # it was begun
                if hasattr(os, "killpg"):
                    with suppress(ProcessLookupError, PermissionError):  # none is left, or no leader yet
                        os.killpg(self._process.pid, signal.SIGKILL)
                self._process.kill()
                self._process.join()
            self._process.close()
        if self._connection is not None:
            self._connection.close()
        self._process = self._connection = None

    def _start(self) -> None:
        """Begin the process. Raises ApartError."""
        spawn = multiprocessing.get_context("spawn")
        here, there = spawn.Pipe()
        self._connection = here
        self._process = spawn.Process(
            target=_serve, args=(there, self.silent), daemon=not self.may_fork, name="apart"
        )
        with single_threaded():
            self._process.start()
        there.close()
        begun = self._answer(STARTING)
        if begun.trouble:
            raise ApartError(f"a process could not be begun: {begun.trouble}, {begun.detail}")

    def _answer(self, limit: float) -> Answer:
        """What the process says within the limit; it is ended where it says nothing."""
        assert self._connection is not None
        end = time.monotonic() + limit
        while (left := end - time.monotonic()) > 0:
            both = [self._connection, self._process.sentinel]
            ready = multiprocessing.connection.wait(both, min(left, LOOK))
            if self._connection in ready:
                try:
                    said = json.loads(self._connection.recv_bytes())
                    return Answer(said["value"], said["trouble"], said["detail"])
                except (EOFError, OSError, ValueError, TypeError, KeyError):
                    break  # it died in the middle of a word
            if ready or not (self._process.is_alive() or self._connection.poll()):
                break
        else:
            self.close()
            return Answer(trouble="time", detail=f"nothing within {limit:g} s")
        self._process.join(1.0)
        code = self._process.exitcode
        self.close()
        return Answer(trouble="died", detail=_ended(code))


def end_with_parent(leader: bool = False) -> None:
    """Have a process end when the one that began it is gone, which it would else wait for, for ever.

    leader: whether it leads a group of its own, which then ends with it.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        if leader:
            os.killpg(os.getpid(), signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def in_one_line(error: BaseException) -> str:
    """An exception's kind and text, and where it was raised."""
    text = " ".join(str(error).split())
    text = text if len(text) <= LONGEST_WORD else text[:LONGEST_WORD] + "..."
    where = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(where[-1].filename).name}, line {where[-1].lineno})" if where else ""
    return f"{type(error).__name__}{f': {text}' if text else ''}{place}"


def _ended(code: int | None) -> str:
    """How a process ended."""
    if code is None:
        return "it said nothing any more"
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code}, {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


def _serve(connection: Connection, silent: bool) -> None:
    """In the process: do what is asked for, until nobody asks any more."""
    if hasattr(os, "setsid"):
        os.setsid()  # so that what it begins can be ended with it; and Ctrl-C is its parent's affair
    end_with_parent(leader=hasattr(os, "setsid"))
    if silent:
        sys.stdout.flush()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
    _say(connection, Answer())
    while True:
        try:
            function, argument = connection.recv()
        except EOFError:
            return
        try:
            answer = Answer(function(argument))
            json.dumps(answer.value, allow_nan=False)
        except BaseException as error:
            answer = Answer(trouble="raised", detail=in_one_line(error))
        _say(connection, answer)


def _say(connection: Connection, answer: Answer) -> None:
    said = {"value": answer.value, "trouble": answer.trouble, "detail": answer.detail}
    connection.send_bytes(json.dumps(said).encode())
