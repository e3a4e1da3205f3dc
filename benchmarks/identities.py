"""Scenes of two people who are reported in a random order, cross, come in at once, or come back; who is mixed up, out.

python benchmarks/identities.py --runs 100
"""

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor

from handtrack.body.people import Settings, follow
from handtrack.body.people_metrics import labels_of, switches
from synth.people_tasks import CROSSINGS, crossing


def mixed_up(job: tuple[str, int]) -> int:
    """Identity switches of one scene."""
    kind, seed = job
    task = crossing(seed, kind)
    return int(switches(labels_of(follow(task.detections, Settings(), 1), task.truth)).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100, help="Scenes of each kind.")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args()
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.runs)
    with ProcessPoolExecutor(chosen.workers) as pool:
        for kind in CROSSINGS:
            found = list(pool.map(mixed_up, [(kind, seed) for seed in seeds]))
            bad = [seed for seed, count in zip(seeds, found, strict=True) if count]
            sys.stdout.write(
                json.dumps({"kind": kind, "runs": chosen.runs, "switches": sum(found), "seeds": bad}) + "\n"
            )


if __name__ == "__main__":
    main()
