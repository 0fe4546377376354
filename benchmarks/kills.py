"""`python -m benchmarks.kills`: kill each process of a run at many moments, and see what is saved and what is left.

Moments are spread over the phases that a process lives through, drawn by the seed. The exit status is 1 where a run
took too long to end, left something, or did not save what it had.
"""

import argparse
import random
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from xrdslam.testing.killing import PHASES, ROLES, Outcome, kill, phase_lengths
from xrdslam.testing.victim import NUM_FRAMES

__all__ = ["moments", "table"]


def moments(role: str, count: int, seed: int) -> list[tuple[str, float]]:
    """Return phases and shares of them: as many of each phase that the role lives through, evenly drawn within it."""
    phases = PHASES if role in ("parent", "visualizer") else PHASES[:3]
    drawn = random.Random(f"{role} {seed}")
    each = -(-count // len(phases))
    return [(phase, (index + drawn.random()) / each) for phase in phases for index in range(each)]


def table(outcomes: Sequence[Outcome]) -> str:
    """Return a Markdown table, a row for each role and phase."""
    heads = ("killed", "while", "moments", "seconds to the end, median (most)", "frames saved of those done")
    heads += ("map, metrics", "faults")
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for role in ROLES:
        for phase in PHASES:
            rows = [o for o in outcomes if (o.role, o.phase) == (role, phase)]
            if rows:
                lines.append(_row(role, phase, rows))
    return "\n".join(lines)


def _row(role: str, phase: str, rows: Sequence[Outcome]) -> str:
    struck = [o for o in rows if o.is_struck]
    late = f" ({len(rows) - len(struck)} too late)" if len(struck) < len(rows) else ""
    seconds = [o.seconds for o in struck or rows]
    with_frames = [o for o in struck if o.frames_done]
    maps, metrics = (sum(getattr(o, name) for o in with_frames) for name in ("has_map", "has_metrics"))
    frames = ", ".join(f"{o.frames_saved}/{o.frames_done}" for o in with_frames) or "-"
    kept = f"{maps}, {metrics} of {len(with_frames)}" if with_frames else "-"
    faults = sum(bool(o.faults()) for o in rows)
    time = f"{statistics.median(seconds):.1f} ({max(seconds):.1f})"
    return f"| {role} | {phase} | {len(rows)}{late} | {time} | {frames} | {kept} | {faults} |"


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__)
    parser.add_argument("--moments", type=int, default=20, help="for each role, at least (default 20)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--roles", nargs="+", choices=ROLES, default=list(ROLES))
    options = parser.parse_args()
    outcomes = []
    with tempfile.TemporaryDirectory() as scratch:
        for role in options.roles:
            lengths = phase_lengths(role, Path(scratch) / role)
            said = ", ".join(f"{phase} {length:.1f} s" for phase, length in lengths.items())
            print(f"{NUM_FRAMES} frames, undisturbed: {said}", flush=True)
            for number, (phase, share) in enumerate(moments(role, options.moments, options.seed)):
                outcome = kill(role, phase, share, lengths, Path(scratch) / f"{role}{number}")
                outcomes.append(outcome)
                print(f"{role}, {share:.0%} of {phase}: {outcome.seconds:.1f} s, {outcome.last_line}", flush=True)
                for fault in outcome.faults():
                    print(f"  FAULT {fault}", flush=True)
    print(table(outcomes))
    return 1 if any(outcome.faults() for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
