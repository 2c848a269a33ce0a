"""The fused engine: worms side by side in lanes where that can be, in packs spread over threads."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.base import Engine
from lattice_gym.engines.fused.kernels.layout import CELL
from lattice_gym.engines.fused.pack import Features, Outputs, Pack, features, n_record, needs_own_pack
from lattice_gym.engines.health import Health
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.state import RodState

_CACHE = 2**20
"""Bytes that a core keeps at hand: what its second-level cache holds, 1 MiB where this was measured."""


class FusedEngine(Engine):
    """Compiled engine: worms with the same features (see `pack.Features`) share packs, and packs share threads.

    With a ball, contact, friction by direction or the energy check each worm has a pack of its own.

    Attributes
    ----------
    packs : list of Pack
        Where the worms are.
    """

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting = "pyelastica",
        *,
        energy_check: bool = False,
        step_check: bool = False,
        num_threads: int | None = None,
    ) -> None:
        super().__init__(
            models, dt, splitting, energy_check=energy_check, step_check=step_check, num_threads=num_threads
        )
        self._pool: tuple[int, ThreadPoolExecutor] | None = None
        self._by_key: dict[_Key, Pack] = {}
        self._arrange()

    def _group(self, worm: int, model: RodModel) -> _Group:
        """Features that the worms of a pack have in common, and the number of a worm that must be alone."""
        alone = self.energy_check or needs_own_pack(model)
        return features(model, self.splitting), worm if alone else None

    def _arrange(self) -> None:
        """Put every worm into a pack. A pack of the same worms stays; in a new one they are at rest."""
        groups: dict[_Group, list[int]] = defaultdict(list)
        for worm, model in enumerate(self.models):
            groups[self._group(worm, model)].append(worm)
        outputs = Outputs(self.position, self.velocity, self.ball_position, self.ball_velocity)
        before, self._by_key = self._by_key, {}
        for group, worms in groups.items():
            for rows in np.array_split(worms, _pack_count(self.models[worms[0]], len(worms), self.num_threads)):
                key, models = (group, tuple(rows.tolist())), [self.models[worm] for worm in rows]
                self._by_key[key] = before.get(key) or Pack(
                    models, self.dt, self.splitting, self.energy_check, rows, outputs
                )
        self.packs = list(self._by_key.values())
        places = {worm: (pack, place) for pack in self.packs for place, worm in enumerate(pack.rows.tolist())}
        self._places = [places[worm] for worm in range(self.n_worm)]

    def _advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
        packs = self.packs
        if len(packs) == 1:
            return packs[0].advance(start, end, n_substeps)
        codes, waiting = np.zeros(self.n_worm, np.int64), iter(packs)

        def work() -> None:
            for pack in waiting:
                codes[pack.rows] = pack.advance(start[pack.rows], end[pack.rows], n_substeps)

        # This thread works as well: to wake another takes as long as some steps.
        others: list[Future[None]] = []
        try:
            # Where no thread can be begun, as at the end of Python, the others do it all.
            with suppress(RuntimeError):
                for _ in range(min(self.num_threads, len(packs)) - 1):
                    others.append(self._threads().submit(work))
            work()
            for other in others:
                other.result()
        except BaseException:  # An interrupt too: begin no further pack, and leave no thread at work on what is shown.
            for _ in waiting:
                pass
            wait(others)
            raise
        return codes

    def _threads(self) -> ThreadPoolExecutor:
        """Threads of this process: those of a parent do not live on in a fork of it."""
        if self._pool is None or self._pool[0] != os.getpid():
            self._pool = os.getpid(), ThreadPoolExecutor(self.num_threads - 1, "worms")
        return self._pool[1]

    def _health(self, worm: int) -> Health:
        pack, place = self._places[worm]
        return pack.health(place)

    def _state(self, worm: int) -> RodState:
        pack, place = self._places[worm]
        return pack.state(place)

    def _restore(self, worm: int, state: RodState) -> None:
        pack, place = self._places[worm]
        pack.restore(place, state)

    def _replace(self, worm: int, model: RodModel) -> None:
        """Cheap where the model has the features of the one before; else worms are packed anew."""
        if self._group(worm, model) == self._group(worm, self.models[worm]):
            pack, place = self._places[worm]
            pack.fill(place, model)
        else:
            self._repack(worm, model)

    def _repack(self, worm: int, model: RodModel) -> None:
        """Arrange all worms anew; all but one keep their state."""
        states, before = [self._state(other) for other in range(self.n_worm)], self._places
        self.models[worm] = model
        self._arrange()
        for other, (pack, place) in enumerate(self._places):
            if other != worm and pack is not before[other][0]:
                pack.restore(place, states[other])

    def _flow(self, worm: int) -> Flow:
        return self._places[worm][0].flow()

    def close(self) -> None:
        """End the threads; a later call to `advance` would begin new ones."""
        super().close()
        if self._pool is not None and self._pool[0] == os.getpid():
            self._pool[1].shutdown()
        self._pool = None


_Group = tuple[Features, int | None]
_Key = tuple[_Group, tuple[int, ...]]


def _pack_count(model: RodModel, n_worm: int, n_thread: int) -> int:
    """Find into how many packs worms go: what the busiest thread has to step through is to be least.

    Few worms leave lanes spare; more than a core's cache holds wait for it.
    """
    best, least = n_worm, math.inf
    for size in range(1, -(-n_worm // n_thread) + 1):
        count = n_record(model, size)
        if size > 1 and count * CELL.itemsize > _CACHE:
            break
        n_pack = -(-n_worm // size)
        if (cost := -(-n_pack // n_thread) * count) < least:
            best, least = n_pack, cost
    return best
