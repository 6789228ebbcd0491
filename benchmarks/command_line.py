"""What the benchmarks share: a command line that has --json, and the file in which their figures end."""

from __future__ import annotations

import argparse
import json
from pathlib import Path


def command_line(description: str | None) -> argparse.ArgumentParser:
    """A command line with the option --json, described by the docstring of a program."""
    line = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    line.add_argument("--json", type=Path, help="write the figures to this file")
    return line


def write_figures(file: Path | None, figures: object) -> None:
    """Write the figures as JSON, if a file was given."""
    if file:
        file.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
