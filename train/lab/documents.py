"""The documents that the page edits, each the content of a problem file, and the folder of such files."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any, Final

from guided_gym.catalogue.files import (
    PROBLEM_SUFFIXES,
    ProblemFile,
    file_of,
    map_file,
    problem_of,
    read_problem_file,
    write_problem_file,
)
from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import shown
from guided_gym.display.scene import robot_table
from guided_gym.errors import GuidedGymError, InvalidInputError, StorageError
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.grammar import Call
from guided_gym.guidance.learned.folders import shipped_agents
from guided_gym.guidance.registry import parts, read_guidance
from guided_gym.problems import Problem

LARGEST: Final = 2**23  # bytes of a file
MOST_CORNERS: Final = 20_000
LONGEST_GUIDANCE: Final = 500  # characters

Document = dict[str, Any]

_NAME: Final = re.compile(r"[^\W_][\w .()+-]{0,99}\.(toml|json)")
_READS_FILES: Final = frozenset({"path_database", "paths", "principal"})
_SHARE: Final = 0.08  # of the workspace's shorter side: the robot that a map without one gets


class Folder:
    """The problem files of one folder, the only files that the lab reads and writes.

    Args:
        path: The folder.

    Raises:
        StorageError: It is none.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_dir():
            raise StorageError(f"{path}: expected a folder, got none")
        self.path = path.resolve()

    def names(self) -> list[str]:
        """The names of its problem files, in order."""
        try:
            there = sorted(self.path.iterdir(), key=lambda file: file.name.lower())
        except OSError as error:
            raise StorageError(f"cannot read {self.path}: {error}") from error
        return [file.name for file in there if _NAME.fullmatch(file.name) and self._is_ours(file)]

    @staticmethod
    def _is_ours(file: Path) -> bool:
        return file.is_file() and not file.is_symlink()

    def file(self, name: object) -> Path:
        """The file of a name.

        Raises:
            InvalidInputError: A name that leads out of the folder, or could.
        """
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise InvalidInputError(
                "name: expected letters, digits, blanks and . ( ) + - with .toml or .json at the end, "
                f"got {str(name)[:100]!r}"
            )
        file = self.path / name
        if file.is_symlink() or (file.exists() and not file.is_file()):
            raise InvalidInputError(
                f"name: expected a file in the lab's folder, got {shown(name)}, which is not one"
            )
        return file

    def read(self, name: object) -> Document:
        """The document of a file.

        Raises:
            StorageError: It cannot be read or is damaged; names the line.
            InvalidInputError: It is no problem file; likewise.
        """
        return document_of_file(self.file(name), self.path)

    def write(self, name: object, document: Document, *, replace: bool) -> None:
        """Write a document, whole or not at all; an unfinished problem, too.

        Raises:
            StorageError: It cannot be written, or there is such a file and it may not be replaced.
            InvalidInputError: The document or the name cannot be used.
        """
        file = self.file(name)
        if file.exists() and not replace:
            raise StorageError(f"{file.name}: expected a new name, got that of an existing file")
        write_problem_file(model_of(document), file)


def document_of_file(file: Path, folder: Path) -> Document:
    """The document of a problem file: its map, if it has one, as polygons; where it lacks a robot, one.

    Raises:
        StorageError: It cannot be read or is damaged; names the line.
        InvalidInputError: It is no problem file; likewise.
    """
    try:
        if file.is_file() and file.stat().st_size > LARGEST:
            raise StorageError(f"{file}: expected at most {LARGEST // 2**20} MiB in the lab, got more")
        model = _planar(read_problem_file(file), str(file))
        environment = model.environment(folder)
        xmin, ymin, xmax, ymax = environment.bounds
        side = _SHARE * min(xmax - xmin, ymax - ymin)
        robot = Robot.rectangle(side, side / 2) if model.robot is None else model.robot.robot()
        corner = [xmin + 2 * side, ymin + 2 * side], [xmax - 2 * side, ymax - 2 * side]
        turn = [0.0] * (robot.dimension - 2)
        poses = {
            name: [*place, *turn] if getattr(model, name) is None else model.configurations()[name]
            for name, place in zip(("start", "goal"), corner, strict=True)
        }
        filled = map_file(file, environment, robot, poses, model.metric.rotation_weight)
    except GuidedGymError as error:  # the page has no use for the folder
        message = str(error).replace(f"{folder}/", "").replace(str(folder), "the file's folder")
        raise type(error)(message) from None
    return checked_document(content_of(filled))


def document_of_text(name: object, text: object) -> Document:
    """The document of a file that the browser read; errors as `document_of_file`."""
    if not isinstance(text, str):
        raise InvalidInputError("text: expected the text of a file, got none")
    suffix = Path(str(name)).suffix.lower()
    if suffix not in PROBLEM_SUFFIXES:
        raise InvalidInputError(f"{str(name)[:100]!r}: expected a problem file (.toml or .json)")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"file{suffix}"
        file.write_text(text, encoding="utf-8", errors="surrogatepass", newline="\n")
        return document_of_file(file, Path(folder))


def example(name: object, seed: object) -> Document:
    """The document of a problem of the catalogue.

    Raises:
        UnknownNameError: There is none of that name.
    """
    if not isinstance(name, str) or not re.fullmatch(r"\w{1,60}", name):
        raise InvalidInputError(f"name: expected that of a problem in the catalogue, got {str(name)[:60]!r}")
    problem = make_distribution(name).problem(whole("seed", seed, most=2**31))
    return checked_document(content_of(_planar(file_of(problem), name)))


def _planar(model: ProblemFile, what: str) -> ProblemFile:
    """The model, if the lab can draw it."""
    if model.room is not None:
        raise InvalidInputError(
            f"{what}: expected a problem in the plane, which the lab can draw, got an arm in space; "
            "guided-gym evaluate and replay take it"
        )
    return model


def content_of(model: ProblemFile) -> Document:
    """What a file of that model says."""
    content = model.model_dump(exclude_defaults=True) | {"format": model.format}
    return {name: content[name] for name in ProblemFile.model_fields if name in content}


def checked_document(document: object) -> Document:
    """A document, if it is not too large for the lab.

    Raises:
        InvalidInputError: It is, or is none.
    """
    if not isinstance(document, dict):
        raise InvalidInputError(f"document: expected a problem, got {type(document).__name__}")
    obstacles = document.get("obstacles", [])
    corners = sum(_corners(part) for part in obstacles) if isinstance(obstacles, list) else 0
    if corners > MOST_CORNERS:
        raise InvalidInputError(
            f"obstacles: expected at most {MOST_CORNERS:,} corners in the lab, got {corners:,}"
        )
    return document


def _corners(part: object) -> int:
    if isinstance(part, dict):
        return sum(map(_corners, part.values()))
    if isinstance(part, list):
        pair = len(part) == 2 and all(isinstance(value, int | float) for value in part)
        return 1 if pair else sum(map(_corners, part))
    return 0


def model_of(document: Document) -> ProblemFile:
    """The model of a document, finished or not.

    Raises:
        InvalidInputError: It is none.
    """
    from pydantic import ValidationError

    checked_document(document)
    try:
        model = ProblemFile.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise InvalidInputError(f"{place or 'document'}: {first['msg']}") from None
    if model.map is not None:
        raise InvalidInputError("map: expected obstacles, got a map: open the file, which reads its map")
    return _planar(model, "document")


def problem_of_document(document: object) -> Problem:
    """The problem of a document.

    Raises:
        InvalidInputError: A part is missing or cannot be used.
    """
    try:
        return problem_of(checked_document(document), Path("problem"))
    except InvalidInputError as error:
        raise InvalidInputError(str(error).removeprefix("problem: ")) from None


def view_of(document: Document) -> dict[str, Any]:
    """What the page needs to draw a document, and what is wrong with it.

    Returns:
        ``robot`` and ``metric`` as in a scene, or null where the robot is none; ``trouble``, a text or null.
    """
    answer: dict[str, Any] = {"robot": None, "metric": None, "trouble": None}
    try:
        model = model_of(document)
        if model.robot is not None:
            robot = model.robot.robot()
            answer["robot"] = robot_table(robot)
            space = ConfigurationSpace(robot, model.environment(Path()), model.metric.rotation_weight)
            answer["metric"] = {"weights": space.weights.tolist(), "periods": space.periods.tolist()}
        problem_of_document(document)
    except GuidedGymError as error:
        answer["trouble"] = str(error)
    return answer


def whole(name: str, value: object, *, least: int = 0, most: int) -> int:
    """A whole number of a request.

    Raises:
        InvalidInputError: It is none between the two.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise InvalidInputError(
            f"{name}: expected a whole number of {least} to {most}, got {str(value)[:60]!r}"
        )
    return value


def checked_guidance(text: object) -> str:
    """An expression that reads no files and imports no code.

    Raises:
        UnknownNameError: A name in it is unknown; the nearest one is suggested.
        InvalidInputError: It cannot be read, or would reach beyond the lab.
    """
    if not isinstance(text, str) or not text.strip():
        raise InvalidInputError("guidance: expected a name or an expression, got none")
    if len(text) > LONGEST_GUIDANCE:
        raise InvalidInputError(f"guidance: expected at most {LONGEST_GUIDANCE} characters, got {len(text)}")
    if found := re.search(r"""[/\\"'~]|\.\.""", text):
        raise InvalidInputError(f"guidance: expected no files and no quotes in the lab, got {found[0]!r}")
    shipped = {f"learned:{name}" for name in shipped_agents()}
    for word in re.findall(r"[^\s,()\[\]=@+]*:[^\s,()\[\]=@+]*", text):
        if word not in shipped:
            raise InvalidInputError(f"guidance: expected {' or '.join(sorted(shipped))}, got {shown(word)}")
    call = read_guidance(text)
    for word in _words(call):
        if word in _READS_FILES or "." in word:
            raise InvalidInputError(f"guidance: the lab reads no files for a guidance, got {shown(word)}")
    for _ in parts(call):  # each of its names is known
        pass
    return text


def _words(value: Any) -> list[str]:
    """The texts and bare words anywhere in an expression."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, tuple):
        return [word for item in value for word in _words(item)]
    if isinstance(value, Call):
        inner = (*value.arguments, *(option.value for option in value.options))
        return [value.name, *(word for item in inner for word in _words(item))]
    return []
