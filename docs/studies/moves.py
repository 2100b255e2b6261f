"""False and true moves of the camera within real-like tracks (see `real_like_tracks.py`).

    OMP_NUM_THREADS=1 python docs/studies/moves.py --still 1000
    OMP_NUM_THREADS=1 python docs/studies/moves.py --moved 40

A false move is one in a track of a camera that stood still, or beside the true one. A true move is found where one of
the moves lies within 30 sightings of it.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import numpy as np
from real_like_tracks import Track, real_like_track

from sunarc.changes.record import calibrate_moved

SIZES_DEG = (0.05, 0.1, 0.2, 0.5, 1.0, 3.0)
_NEAR = 30
"""Sightings by which a move may be misdated and still be the true one."""


class Outcome(NamedTuple):
    """What a track's fit said: its moves, how far the nearest is from the true one in sightings, and its cost."""

    turns_deg: tuple[float, ...]
    accepted: bool
    misdated: int | None
    seconds: float

    @property
    def found(self) -> bool:
        """Whether the true move is among them."""
        return self.misdated is not None and self.misdated <= _NEAR


def outcome(track: Track) -> Outcome:
    """Fit a track and compare its moves with the truth."""
    begun = time.process_time()
    solved = calibrate_moved(track.points, site=track.site, image_size=track.image_size, options=track.options)[0]
    took = time.process_time() - begun
    moves, times = solved.evidence.moves, track.points.unix_s
    row = int(np.searchsorted(times, track.moved_at))
    off = [abs(int(np.searchsorted(times, move.time)) - row) for move in moves]
    misdated = min(off) if off and np.isfinite(track.moved_at) else None
    return Outcome(tuple(move.turn_deg for move in moves), solved.verdict.accepted, misdated, took)


def still(first: int, count: int) -> list[int]:
    """Print the false moves of cameras that stood still; return their seeds."""
    false, accepted, seconds = [], 0, 0.0
    for seed in range(first, first + count):
        found = outcome(real_like_track(seed))
        accepted += found.accepted
        seconds += found.seconds
        if found.turns_deg:
            false.append(seed)
            print(f"track {seed}: accepted {found.accepted}, moves {np.round(found.turns_deg, 3)} degrees", flush=True)
        if (seed - first) % 50 == 49:
            print(f"... {seed - first + 1} tracks: {len(false)} with a false move", flush=True)
    print(f"{count} tracks ({accepted} accepted, {seconds / count:.2f} s each): {len(false)} with a false move {false}")
    return false


def moved(first: int, count: int) -> dict[float, list[Outcome]]:
    """Print how many true moves of each size were found."""
    table = {}
    print("| turn, degrees | found | misdated: median, most (sightings) | false beside it |", flush=True)
    for size in SIZES_DEG:
        table[size] = [outcome(real_like_track(seed, move_deg=size)) for seed in range(first, first + count)]
        hits = [one.misdated for one in table[size] if one.misdated is not None and one.found]
        off = f"{np.median(hits):.0f}, {max(hits)}" if hits else "-"
        beside = sum(len(one.turns_deg) - one.found for one in table[size])
        print(f"| {size} | {len(hits)} of {count} | {off} | {beside} |", flush=True)
    return table


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--still", type=int, default=0, help="tracks of cameras that stand still")
    parser.add_argument("--moved", type=int, default=0, help="tracks of each size of a move")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    chosen = parser.parse_args()
    if chosen.still:
        still(chosen.first, chosen.still)
    if chosen.moved:
        moved(chosen.first, chosen.moved)


if __name__ == "__main__":
    main()
