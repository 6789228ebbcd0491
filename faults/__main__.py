"""``python -m faults``: the campaign. Prints its seed and a table of what was tried and what failed."""

from __future__ import annotations

import argparse
import json
import secrets
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from faults.tally import Tally

Part = Callable[[int, float], list[Tally]]


def _parts() -> dict[str, Part]:
    from faults import api, files, hostile, processes, references

    return {
        "motions": references.motions,
        "numbers": references.numbers,
        "distances": references.distances,
        "proofs": references.proofs,
        "trees": references.trees,
        "files": files.mutate,
        "maps": hostile.bad_maps,
        "resets": hostile.resets,
        "api": api.fuzz,
        "kills": processes.kills,
        "disks": processes.disks,
        "writers": processes.writers,
    }


def table(tallies: list[Tally]) -> str:
    """The table, as Markdown."""
    lines = ["| what was tried | promise | tried | failed | seconds |", "|---|---|---:|---:|---:|"]
    for t in tallies:
        tried = f"{t.tried:,}" if not t.note else f"none: {t.note}"
        lines.append(f"| {t.kind} | {t.promise} | {tried} | {len(t.failures)} | {t.seconds:.0f} |")
    return "\n".join(lines)


def main() -> int:
    """Run it; 1 if a promise was broken."""
    parts = _parts()
    parser = argparse.ArgumentParser(prog="python -m faults", description=__doc__)
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(parts)}; all by default")
    parser.add_argument("--share", type=float, default=1.0, help="of the usual number of tries")
    parser.add_argument("--seed", type=int, default=None, help="of everything random; drawn if not given")
    parser.add_argument("--json", type=Path, default=None, help="file for the tallies")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.parts) - set(parts))
    if unknown or not 0 < arguments.share <= 100:
        parser.error(
            f"expected a share above 0 and parts of {', '.join(parts)}, got {unknown or arguments.share}"
        )
    seed = secrets.randbelow(2**31) if arguments.seed is None else arguments.seed
    print(f"seed {seed}, share {arguments.share:g}", flush=True)
    warnings.simplefilter("ignore")
    tallies: list[Tally] = []
    for name in arguments.parts or parts:
        began = time.perf_counter()
        print(f"{name} ...", file=sys.stderr, end=" ", flush=True)
        tallies += parts[name](seed, arguments.share)
        print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    print(table(tallies))
    for tally in tallies:
        for failure in tally.failures[:20]:
            print(f"FAILED {tally.kind}: {failure}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(t) for t in tallies], indent=1) + "\n")
    return int(any(tally.failures for tally in tallies))


if __name__ == "__main__":
    sys.exit(main())
