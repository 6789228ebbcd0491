"""Kernels without reference counts: what `borrowing` asks of them, read from their sources."""

from __future__ import annotations

import ast
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from numba import njit

import guided_gym.kernels
from guided_gym.kernels.plain import borrowing, owning

KERNELS = Path(guided_gym.kernels.__file__).parent
NUMBERS = {"int", "float", "bool", "None", "tuple", "np.float32"}
SCALAR = {
    "floor",
    "sqrt",
    "rint",
    "abs",
    "exp",
    "log",
    "isfinite",
    "isnan",
    "copysign",
    "uint8",
    "uint32",
    "int64",
    "float32",
}
DECORATORS = ("njit", "borrowing", "owning")


def kernels() -> dict[tuple[str, str], tuple[str, ast.FunctionDef]]:
    """The decorator and source of each kernel, by module and name."""
    found = {}
    for path in KERNELS.glob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.FunctionDef):
                names = [ast.unparse(d).split("(")[0] for d in node.decorator_list]
                kind = next((name for name in names if name in DECORATORS), "")
                found[path.stem, node.name] = kind, node
    return found


def imported(module: str) -> dict[str, tuple[str, str]]:
    """Names that a module imports from other modules of kernels."""
    return {
        alias.asname or alias.name: (node.module.split(".")[-1], alias.name)
        for node in ast.parse((KERNELS / f"{module}.py").read_text()).body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("guided_gym.kernels.")
        for alias in node.names
        if node.module
    }


def called(module: str, function: ast.FunctionDef) -> set[tuple[str, str]]:
    """Functions of this room that a function calls."""
    names = imported(module)
    calls = {
        node.func.id
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    return {names.get(name, (module, name)) for name in calls}


def made_by(function: ast.FunctionDef) -> list[str]:
    """Expressions of a function that make an array, as far as its source tells."""
    arrays = {
        a.arg
        for a in function.args.args
        if re.search(r"s$|Array|Field|Links", ast.unparse(a.annotation or a))
    } - {a.arg for a in function.args.args if ast.unparse(a.annotation or a) in NUMBERS}

    def is_array(node: ast.expr) -> bool:
        whole = isinstance(node, ast.Name) and node.id in arrays
        return whole or (
            isinstance(node, ast.Subscript) and any(isinstance(n, ast.Slice) for n in ast.walk(node))
        )

    made = []
    for node in ast.walk(function):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called.startswith("np.") and called.split(".")[1] not in SCALAR:
                made.append(called)
            if isinstance(node.func, ast.Attribute) and node.func.attr in ("copy", "astype", "min", "max"):
                made.append(called)
        operands = [node.left, node.right] if isinstance(node, ast.BinOp) else []
        operands += [node.left, *node.comparators] if isinstance(node, ast.Compare) else []
        made += [ast.unparse(node) for operand in operands if is_array(operand)]
        if isinstance(node, ast.List | ast.ListComp | ast.Set | ast.Dict):
            made.append(ast.unparse(node))
    return made


def test_borrowing_kernels__return_numbers_make_no_arrays_and_call_none_that_would_take_their_options() -> (
    None
):
    found = kernels()
    borrowers = {key: node for key, (kind, node) in found.items() if kind == "borrowing"}
    assert len(borrowers) > 150
    for (module, name), node in borrowers.items():
        returned = set(re.findall(r"[\w.]+", ast.unparse(node.returns or ast.Constant(None))))
        assert returned <= NUMBERS, f"{module}.{name} returns {returned}: its arrays would be let go twice"
        assert not made_by(node), f"{module}.{name} makes {made_by(node)}, which nobody would let go"
        plain = {f"{m}.{n}" for m, n in called(module, node) if found.get((m, n), ("",))[0] == "njit"}
        assert not plain, f"{module}.{name} calls {plain}, which numba would compile without counts, too"


@pytest.mark.parametrize(
    "body",
    ["return np.zeros(3)[0]", "return (values + 1.0)[0]", "return (2.0 * values[1:])[0]", "return [1][0]"],
)
def test_made_by__finds_what_makes_an_array(body: str) -> None:
    source = f"def kernel(values: FloatArray, x: float) -> float:\n    {body}\n"
    node = ast.parse(source).body[0]
    assert isinstance(node, ast.FunctionDef)
    assert made_by(node)


def test_borrowing__counts_no_references_and_calls_what_makes_arrays() -> None:
    def some(values: np.ndarray, more: np.ndarray, many: int) -> float:
        total = values[0]
        if many > 1:
            total += more[many]
        return min(total, values[1])

    def fresh(values: np.ndarray) -> float:
        return (values + 1.0)[0]

    def outer(values: np.ndarray) -> float:
        return inner(values)

    inner = owning(fresh)
    values = np.array([2.0, 3.0, 4.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # functions in functions are not kept
        assert borrowing(some)(values, values, 2) == 3.0
        assert borrowing(outer)(values) == 3.0
    # Of a kernel that was kept there is nothing to read, so it is compiled by the same option once more.
    kernel = njit(_nrt=borrowing(some).targetoptions["_nrt"])(some)  # type: ignore[attr-defined,call-overload]
    assert kernel(values, values, 2) == 3.0
    text = next(iter(kernel.inspect_asm().values()))
    assert "ret" in text and "NRT_incref" not in text
