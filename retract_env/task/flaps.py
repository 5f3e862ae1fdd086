"""The arrays of n flaps on rods and of their episodes, what goes into them, and the threads that compute."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env import scenarios
from retract_env.grasp import Grasp
from retract_env.physics.registry import physics_kind
from retract_env.physics.rod import flap_numbers, laws, sight_numbers
from retract_env.rod.block import STATE, new_blocks
from retract_env.rod.chain import LANES
from retract_env.scenarios import prior_numbers, stated_numbers
from retract_env.scene import UNKNOWNS, Scene, sample_scene
from retract_env.scene import flaps as drawn
from retract_env.scene.pcg64 import WORDS, give_back, state_of
from retract_env.scene.sampling import SceneRanges
from retract_env.spring.columns import veins_of
from retract_env.task.arrays import INFO, Lanes, Rules, Told
from retract_env.task.config import TaskConfig
from retract_env.task.observation import SIZE, SLICES, Sensors, bounds
from retract_env.task.rules import KEYPOINTS, STIFFNESS_SAMPLES, TERMS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Flaps:
    """The arrays of n flaps and their episodes, and what goes into them."""

    def __init__(
        self,
        n: int,
        task: TaskConfig,
        ranges: SceneRanges,
        sensors: Sensors,
        alike: Scene,
        unknown: bool,
    ):
        """alike: a scene that has what all random flaps have alike; unknown: whether each episode is a draw
        of what is not known."""
        self._alike = alike
        blocks = -(-n // LANES)
        self.blocks = new_blocks(blocks)
        weights = task.weights.model_dump()
        low, high = bounds(task)
        hidden = np.zeros(SIZE, np.bool_)
        for name in sensors.hide:
            hidden[SLICES[name]] = True
        noise = sensors.deviation if sensors.noise else np.empty(0)
        self.rules = Rules(
            np.array([weights[name] for name in TERMS]),
            np.array(task.move),
            task.grip == "force",
            np.array(task.firmness),
            task.steps,
            task.cap,
            task.limits == "end",
            low,
            high,
            noise,
            hidden,
            drawn.table(ranges),
            *laws(),
            unknown,
        )
        _, vertices, offsets, moduli = drawn.room(max(ranges.veins[1], 1))

        def rows(*shape: int) -> Array:
            return np.zeros((n, *shape))

        def flags() -> Flags:
            return np.zeros(n, np.bool_)

        self.lanes = Lanes(
            rng=np.zeros((n, WORDS), np.uint64),
            random=flags(),
            scalars=rows(len(drawn.SCALARS)),
            vertices=rows(*vertices.shape),
            offsets=np.zeros((n, len(offsets)), np.int64),
            moduli=rows(len(moduli)),
            stated=rows(scenarios.NUMBERS),
            numbers=rows(scenarios.NUMBERS),
            prior=rows(scenarios.PRIOR),
            asked=np.full((n, len(UNKNOWNS)), np.nan),
            drawn=flags(),
            z=rows(len(UNKNOWNS)),
            given=np.full((n, 3), np.nan),
            limits=rows(3),
            k_eq=rows(STIFFNESS_SAMPLES),
            sight=rows(3),
            outset=rows(),
            holding=flags(),
            missed=flags(),
            off=rows(3),
            steps=np.zeros(n, np.int64),
            pose=rows(4),
            jaws=rows(4),
            grasp=rows(2),
            section=np.zeros((n, KEYPOINTS), np.int64),
            share=rows(KEYPOINTS),
            strain=rows(),
            friction=rows(2),
            clearance=rows(),
            exposure=rows(),
            most_strain=rows(),
            most_friction=rows(),
            overlapped=flags(),
            broken=np.zeros(n, np.int64),
            in_view=flags(),
            over=flags(),
            terms=rows(len(TERMS)),
        )
        observation = np.zeros((n, SIZE), np.float32)
        self.told = Told(
            observation,
            rows(),
            flags(),
            flags(),
            rows(INFO),
            observation.copy(),
            rows(INFO),
            flags(),
            flags(),
        )

    def put(self, k: int, scene: Scene) -> None:
        """Give environment k this scene. Raises SceneError for one whose law the rod does not know."""
        physics_kind("rod").accepted(scene)
        vertices, offsets, moduli = veins_of(scene.tissue)
        self._make_room(len(vertices), len(moduli))
        lanes = self.lanes
        lanes.random[k] = False
        lanes.vertices[k, : len(vertices)] = vertices
        lanes.offsets[k, : len(offsets)], lanes.offsets[k, len(offsets) :] = offsets, offsets[-1]
        lanes.moduli[k, : len(moduli)], lanes.moduli[k, len(moduli) :] = moduli, 0.0
        self._alike_in(k, scene)

    def give(self, k: int, grasp: Grasp | None) -> None:
        """Have environment k take this grasp when its next episode begins; None: the agent chooses."""
        row = (np.nan,) * 3
        if grasp is not None:
            row = grasp.x, grasp.compression, np.nan if grasp.force is None else grasp.force
        self.lanes.given[k] = row

    def ask(self, k: int, z: Array | None) -> None:
        """Have environment k's next episode be this draw (UNKNOWNS,); None: whatever the settings say."""
        self.lanes.asked[k] = np.nan if z is None else z

    def put_random(self, k: int) -> None:
        """Have environment k draw a flap when its next episode begins."""
        self.lanes.random[k] = True
        self._alike_in(k, self._alike)

    def sample(self, k: int, ranges: SceneRanges) -> Scene:
        """The scene that environment k would draw next; its generator goes on."""
        generator = np.random.Generator(np.random.PCG64())
        give_back(generator, self.lanes.rng[k])
        scene = sample_scene(generator, ranges)
        self.lanes.rng[k] = state_of(generator)
        return scene

    def _alike_in(self, k: int, scene: Scene) -> None:
        block, lane = divmod(k, LANES)
        self.blocks.flap[block, lane], self.blocks.sight[block, lane] = (
            flap_numbers(scene),
            sight_numbers(scene),
        )
        self.lanes.stated[k], self.lanes.prior[k] = stated_numbers(scene), prior_numbers(scene)
        limits = scene.limits
        self.lanes.limits[k] = limits.strain, limits.friction, limits.clearance

    def _make_room(self, vertices: int, veins: int) -> None:
        lanes = self.lanes
        more = max(0, vertices - lanes.vertices.shape[1]), max(0, veins - lanes.moduli.shape[1])
        if any(more):
            offsets = np.pad(lanes.offsets, ((0, 0), (0, more[1])), mode="edge")
            moduli = np.pad(lanes.moduli, ((0, 0), (0, more[1])))
            grown = np.pad(lanes.vertices, ((0, 0), (0, more[0]), (0, 0)))
            self.lanes = lanes._replace(vertices=grown, offsets=offsets, moduli=moduli)

    def state(self) -> dict[str, NDArray[Any]]:
        """Copies of all that n environments go on from, n rows each."""
        n = len(self.lanes.steps)
        kept = {name: array.copy() for name, array in self.lanes._asdict().items()}
        kept["observation"] = self.told.observation.copy()
        for name in STATE:
            array = getattr(self.blocks, name)
            if array.ndim == 2:
                array = array.reshape(len(array), -1, LANES).transpose(0, 2, 1)
            kept[f"block.{name}"] = array.reshape(-1, array.shape[-1])[:n].copy()
        return kept

    def set_state(self, kept: Mapping[str, NDArray[Any]]) -> None:
        """Go on from there."""
        n = len(self.lanes.steps)
        room = self.lanes.vertices.shape[1], self.lanes.moduli.shape[1]
        self.lanes = Lanes(**{name: kept[name].copy() for name in Lanes._fields})
        self._make_room(*room)  # a state may come from where flaps have fewer veins
        self.told.observation[...] = kept["observation"]
        for name in STATE:
            array = getattr(self.blocks, name)
            rows = array.shape[-1] if array.ndim == 3 else array.shape[-1] // LANES
            padded = np.zeros((len(array) * LANES, rows))
            padded[:n] = kept[f"block.{name}"]
            by_lane = padded.reshape(len(array), LANES, rows)
            array[...] = by_lane if array.ndim == 3 else by_lane.transpose(0, 2, 1).reshape(len(array), -1)


class Workers:
    """Threads that share the blocks of `Flaps` among them."""

    def __init__(self, threads: int):
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()

    def run(self, kernel: Any, flaps: Flaps, *arguments: Any) -> None:
        """Have a kernel of `retract_env.task.batch` do all blocks."""
        count = len(flaps.blocks.flap)
        threads = min(self.threads, count)
        ends = [count * k // threads for k in range(threads + 1)]
        ranges = list(pairwise(ends))
        common: tuple[Any, ...] = flaps.blocks, flaps.lanes, flaps.rules, flaps.told
        if threads == 1:
            kernel(*common, 0, count, *arguments)
            return
        if self._pool is None or self._process != os.getpid():  # a forked process has no threads
            self._pool, self._process = ThreadPoolExecutor(self.threads - 1), os.getpid()
        waiting = [self._pool.submit(kernel, *common, *part, *arguments) for part in ranges[1:]]
        kernel(*common, *ranges[0], *arguments)
        for one in waiting:
            one.result()

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pool": None}
