"""How `retract plan` and `retract certify` tell a verdict and where the time went, and what both may be
asked for."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from baselines.cli.console import NotCertified
from baselines.cli.robust import told
from baselines.cli.words import FAILS

if TYPE_CHECKING:
    from planners.certify import Certificate
    from retract_env.grasp import Grasp, JawPath
    from retract_env.scene import Scene

MM = MN = 1e3

Resolution = Literal["fine", "medium", "coarse"]
ResolutionOption = Annotated[
    Resolution, typer.Option(help="Mesh of the finite elements; `fine` is for certificates.")
]
VerifyOption = Annotated[
    bool, typer.Option("--verify", help="Repeat it on a finer mesh and report the differences.")
]


def describe(certificate: Certificate) -> str:
    """The verdict of a certificate and its margins, on one line."""
    c = certificate
    verdict = "certified" if c.reason == "ok" else f"not certified: {FAILS.get(c.reason, c.reason)}"
    facts = (
        f"grasp {c.grasp['x'] * MM:.2f} mm",
        f"force {c.grasp['force'] * MN:.1f} mN"
        if "force" in c.grasp
        else f"compression {c.grasp['compression'] * MM:.2f} mm",
        f"strain {c.max_strain:.3f} of {c.strain_limit:g}",
        f"friction {c.required_friction:.2f} of {c.friction_limit:g}",
        f"clearance {c.clearance * MM:.2f} mm",
    )
    return f"{verdict}; {', '.join(facts)}"


def margins(certificate: Certificate) -> str:
    """By how much the judge itself may be off, on one line; "" where a certificate does not say."""
    said = certificate.margins
    if said is None:
        return ""
    mesh, peaks = said["mesh"], said["peaks"]
    between = f"strain {100 * peaks['strain']:.2g} % and friction {peaks['friction']:g} between increments"
    meshed = (
        "this mesh with this law was not compared with another code"
        if mesh is None
        else f"strain {100 * mesh['strain']:.2g} % and friction {mesh['friction']:g} for the mesh"
    )
    creep = f"{100 * said['patch_slip']:.2g} % more friction where tissue creeps under the jaws"
    return f"the judge may be off by: {meshed}; {between}; {creep}"


def verified_if_meshed(certificate: Certificate, scene: Scene, grasp: Grasp, path: JawPath) -> Certificate:
    """The certificate as verified on a finer mesh; as it is, with a line that says so, if there is none."""
    from planners.certify import verified
    from retract_env.errors import MeshError

    try:
        return verified(certificate, scene, grasp, path)
    except MeshError as problem:
        typer.echo(f"not verified on a finer mesh: {problem}", err=True)
        return certificate


def report(certificate: Certificate) -> None:
    """Print the verdict, what the judge may be off by, what a finer mesh and the robust statement say, where
    they were asked for. Raises NotCertified, but not for what is not robust."""
    if not certificate.certified:
        raise NotCertified(describe(certificate))
    typer.echo(describe(certificate))
    if said := margins(certificate):
        typer.echo(said)
    if certificate.verification is not None:
        _report_finer(certificate.verification)
    if certificate.moving is not None:
        typer.echo(_in_time(certificate.moving))
    for line in told(certificate):
        typer.echo(line)


def check_robust(certificate: Certificate) -> None:
    """Raise NotCertified where the robust statement does not hold."""
    if certificate.robust is not None and not certificate.robust["holds"]:
        raise NotCertified("certified as the scene says, but not robust")


def _in_time(moving: Mapping[str, Any]) -> str:
    """What the motion comes to in time, on one line."""
    how = f"at {moving['speed'] * MM:g} mm/s, in {moving['duration']:.3g} s, from a {moving['start']} start"
    if math.isinf(moving["max_strain"]):
        return f"{how}: no solution was found"
    return (
        f"{how}: strain {moving['max_strain']:.3f}, friction {moving['required_friction']:.2f}, "
        f"clearance {moving['clearance'] * MM:.2f} mm at least once the jaws stand still"
        + (", but tissue runs into itself or the fixed block" if moving["overlap"] else "")
    )


def _report_finer(finer: Mapping[str, Any]) -> None:
    mesh = f"the {finer['resolution']} mesh of {finer['nodes']} nodes"
    if finer["reason"] != "ok":
        raise NotCertified(f"not certified on {mesh}: {finer['reason']}")
    typer.echo(
        f"verified on {mesh}: strain {finer['max_strain']:.3f} ({finer['max_strain_difference']:+.1%} here), "
        f"friction {finer['required_friction']:.2f} ({finer['required_friction_difference']:+.2f} here)"
    )


class Clock:
    """Seconds by phase, to say where the time goes."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Count the seconds of the block to the phase of that name."""
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def summary(self, work: Mapping[str, float] | None = None) -> str:
        """One line of wall-clock, and one of `work`: s by kind, summed over threads."""
        phases = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in self.seconds.items())
        line = f"time: {time.perf_counter() - self.start:.1f} s; {phases}"
        parts = {name: seconds for name, seconds in (work or {}).items() if name != "total"}
        if parts:
            largest_first = sorted(parts.items(), key=lambda item: -item[1])
            line += "\n  planning, summed over threads: " + ", ".join(
                f"{name} {s:.1f} s" for name, s in largest_first
            )
        return line
