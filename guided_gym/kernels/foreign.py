"""Calls of a collision kernel by its address: robots that most searches never see cost them no compilation.

numba compiles a function together with all that it calls. If the kernels of each kind of robot stood behind
an `if` in those for a rigid body, every search loop would be compiled with all of them inside. So a geometry
may hold the address of one compiled function that answers for its robot, and 0 stands for a rigid body.
"""
# mypy: disable-error-code="misc,no-any-return,no-untyped-call,import-untyped"

from __future__ import annotations

from typing import Any, Final

from llvmlite import ir
from numba import types  # type: ignore[attr-defined]
from numba.extending import intrinsic

POSE_FREE, CLEARANCE, FRACTION, WHOLE, TOOL_X, TOOL_Y = range(6)
"""What is asked: is pose a free; its clearance; the free part of the motion a -> b; 1.0 if all of it is; and
where the robot is at a, which is its tool's place."""

SIGNATURE: Final = types.float64(
    types.int64,
    types.CPointer(types.float64),
    types.CPointer(types.float64),
    types.int64,
    types.CPointer(types.float64),
    types.CPointer(types.int64),
)
"""What is asked, a, b, how many coordinates they have, and the two arrays of the geometry."""


@intrinsic
def call(typingctx: Any, address: Any, asked: Any, a: Any, b: Any, numbers: Any, index: Any) -> Any:
    """Call the function of `SIGNATURE` at an address with arrays, all of them contiguous."""
    if any(not isinstance(x, types.Array) or x.layout != "C" for x in (a, b, numbers, index)):
        return None
    signature = types.float64(types.int64, types.int64, a, b, numbers, index)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        arrays = [
            context.make_array(kind)(context, builder, value=value)
            for kind, value in zip(signature.args[2:], args[2:], strict=True)
        ]
        word, real = ir.IntType(64), ir.DoubleType()
        size = builder.extract_value(arrays[0].shape, 0)
        kind = ir.FunctionType(
            real, [word, real.as_pointer(), real.as_pointer(), word, real.as_pointer(), word.as_pointer()]
        )
        function = builder.inttoptr(args[0], kind.as_pointer())
        a, b, numbers, index = (array.data for array in arrays)
        return builder.call(function, [args[1], a, b, size, numbers, index])

    return signature, codegen
