"""Files made to harm, and long runs: what unpacks to gigabytes, points elsewhere or nests without end."""

from __future__ import annotations

import importlib.util
import io
import os
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import gymnasium
import numpy as np

import guided_gym as gg
from faults.files import trouble
from faults.tally import Tally

_MOST = 4096.0  # MiB that reading may take: the limit of sizes that the package states
_GROWTH = 10.0  # MiB that all resets but the first may add
_FIRST = 100  # resets
_ROS = "image: {}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
_PROBLEM = '[map]\nfile = {}\n\n[robot]\ntype = "point"\n\n[task]\nstart = [0.15, 0.15]\ngoal = [0.3, 0.3]\n'


def _png(width: int, height: int, rows: int) -> bytes:
    """A black picture of one bit a pixel that says one size, and has so many rows."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer, row, packed = zlib.compressobj(9), bytes(1 + (width + 7) // 8), []
    for _ in range(rows):
        packed.append(packer.compress(row))
    data = b"".join([*packed, packer.flush()])
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _npy(shape: str, kind: str = "<f8") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": (3, 3)})
    return file.getvalue().replace(b"(3, 3)", shape.encode(), 1)


def _pictures(rng: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    big = int(rng.integers(20_000, 60_000))
    yield "bomb.png", _png(big, big, big)
    yield "long.png", _png(2**31 - 1, 1, 1)
    yield "short.png", _png(8000, 8000, 3)
    noise = rng.integers(0, 256, (int(rng.integers(5500, 8000)),) * 2, np.uint8)
    yield "noise.pgm", b"P5 %d %d 255\n" % noise.shape + noise.tobytes()
    yield "words.pgm", b"P2 5000 5000 255\n" + b"7 " * int(rng.integers(1, 24_999_999))
    yield "claim.pgm", b"P5 %d %d 255\n" % (big, big)
    yield "digits.pgm", b"P5 " + b"9" * 100_000 + b" 1 255\n"
    yield "comment.pgm", b"P5 " + b"#" * 10_000_000 + b"\n"
    yield "claim.npy", _npy(f"({10**6}, {10**6})")
    yield "negative.npy", _npy("(-1, 8)")
    yield "objects.npy", _npy("(2, 2)", "|O")
    yield "claim.map", b"type octile\nheight 9999999\nwidth 9999999\nmap\n..\n"


def _texts(rng: np.random.Generator) -> Iterator[tuple[str, str]]:
    depth = int(rng.integers(10_000, 100_000))
    yield "deep.geojson", '{"type": "Polygon", "coordinates": ' + "[" * depth + "]" * depth + "}"
    yield "deep.json", "[" * depth
    yield "deep.toml", "a = " + "[" * depth
    yield "keys.toml", ".".join("a" * depth) + " = 1"
    yield "digits.json", '{"robot": ' + "9" * depth + "}"
    yield "digits.geojson", '{"type": "Point", "coordinates": [1e999, ' + "9" * depth + "]}"
    yield "deep.yaml", "- " * depth
    yield "flow.yaml", "a: " + "{" * depth
    yield "laughs.yaml", "a: &a [x, x]\n" + "".join(f"b{i}: &b{i} [*a, *a]\n" for i in range(50))
    yield "python.yaml", "image: !!python/object/apply:os.system ['touch hacked']\n"
    yield "digits.yaml", _ROS.format("map.pgm").replace("0.1", "9" * depth)


def _elsewhere(folder: Path) -> Iterator[tuple[str, str]]:
    """Files that name another one outside their folder: all of these are good maps, at those places."""
    secret = folder.parent / "secret.pgm"
    secret.write_bytes(b"P5 4 4 255\n" + bytes([255] * 16))
    (folder.parent / "secret.yaml").write_text(_ROS.format("secret.pgm"))
    (folder / "link.pgm").symlink_to(secret)
    for number, name in enumerate(("../secret.pgm", str(secret), "link.pgm", "sub/../../secret.pgm")):
        yield f"outside{number}.yaml", _ROS.format(name)
    for number, name in enumerate(("../secret.yaml", str(folder.parent / "secret.yaml"), "/dev/zero")):
        yield f"outside{number}.toml", _PROBLEM.format(repr(name))
    for name in ("/dev/zero", "/proc/self/mem", "map\0.pgm", "", ".", "x" * 5000):
        yield f"odd{abs(hash(name)) % 1000}.yaml", _ROS.format(repr(name))


def bad_maps(seed: int, share: float) -> list[Tally]:
    """Maps and problem files made to harm; ``share`` of them."""
    bombs = Tally("maps that unpack to gigabytes", f"one clear error, at most {_MOST / 1024:g} GiB, 20 s")
    nested = Tally("maps nested without end, aliases, code", "one clear error; no code runs; 20 s")
    outside = Tally("maps that point outside their folder", "one clear error; what is there is not read")
    if any(importlib.util.find_spec(name) is None for name in ("PIL", "yaml")):
        bombs.note = nested.note = outside.note = "needs the extra maps"
        return [bombs, nested, outside]
    rng = np.random.default_rng(seed)
    for _ in range(max(1, round(share))):
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "maps"
            folder.mkdir()
            with bombs.timed():
                for name, data in _pictures(rng):
                    (folder / name).write_bytes(data)
                    _refused(bombs, folder / name, f"seed {seed}, {name}")
                    (folder / name).unlink()
            with nested.timed():
                for name, text in _texts(rng):
                    (folder / name).write_text(text)
                    _refused(nested, folder / name, f"seed {seed}, {name}")
            with outside.timed():
                for name, text in _elsewhere(folder):
                    (folder / name).write_text(text)
                    _refused(outside, folder / name, f"seed {seed}, {name}: {text[:40]!r}")
            nested.check(not Path("hacked").exists(), f"seed {seed}: code ran")
    return [bombs, nested, outside]


def _refused(tally: Tally, file: Path, where: str) -> None:
    """One try: an error of ours, no more memory than allowed, and nothing was taken for a map."""
    read: Callable[[Path], object]
    if file.suffix in (".toml", ".json"):
        read = gg.load_problem
    else:

        def read(path: Path) -> object:
            return gg.read_map(path, gg.MapOptions(resolution=0.1))

    taken: list[object] = []
    before = _restart_peak()
    wrong = trouble(lambda path: taken.append(read(path)), file)
    grown = _peak() - before
    if wrong is None and taken:
        wrong = f"was taken for {str(taken[0])[:60]}"
    if wrong is None and grown > _MOST:
        wrong = f"took {grown:.0f} MiB"
    tally.check(wrong is None, f"{where}: {wrong}")


def _restart_peak() -> float:
    """Forget the most memory that this process has had, where the system can; returns what it has (MiB)."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return _peak()
    return _peak()


def _peak() -> float:
    """The most memory that this process has had (MiB); 0 where the system does not say."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return 0.0
    return float(status.partition("VmHWM:")[2].split()[0]) / 1024


def resets(seed: int, share: float) -> list[Tally]:
    """Episodes of environments whose problems are drawn: memory as the system counts it."""
    tally = Tally("resets", f"after {_FIRST} resets, 1,900 more add at most {_GROWTH:g} MB")
    if not _memory():
        tally.note = "the system does not say what memory a process has"
        return [tally]
    for name in ("TrapCup", "RandomSimplePassage", "RandomPointMaze", "RandomTrapCup"):
        with tally.timed():
            env = gymnasium.make(f"guided_gym/{name}-v0")
            sizes: list[float] = []
            for number in range(_FIRST + max(20, round(1900 * share))):
                env.reset(seed=seed + number)
                env.step(0)
                sizes.append(_memory())
            # One fine grid more or less is no growth: the mean of the last hundred.
            grown = float(np.mean(sizes[_FIRST:][-100:])) - sizes[_FIRST - 1]
            tally.check(grown <= _GROWTH, f"seed {seed}, {name}: {grown:.1f} MB")
    return [tally]


def _memory() -> float:
    """MB that this process has; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, AttributeError, ValueError):
        return 0.0
