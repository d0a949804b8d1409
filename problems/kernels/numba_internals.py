"""What numba does not promise to its users, all of it here; with other versions it is done without.

Six things rest on how numba 0.61 to 0.68 works inside.  Where another version runs, `LOST` says
what is lost; everything else is the same.

1. `OwnCopies`: bit for bit the same results from a run that compiles and one from the cache.
2. `lent`: no counting of who holds an array, up to three quarters of the time of a step.
3. `take_literals_as_numbers`: a tenth of the time that compiling takes.
4. `OneScope`: a quarter of what the method's takes.
5. `found_before`: a quarter of what is left.
6. `only_where_it_is_named`: a twentieth.

`in_place`, `read_only`, `in_rows` and `function_at` are made with numba's interface for extensions.
"""

from __future__ import annotations

import copy
import operator
from typing import Any

import numba
from llvmlite.binding import Linkage
from numba.core import cgutils, inline_closurecall, ssa, types
from numba.core.caching import Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.datamodel import default_manager
from numba.core.imputils import impl_ret_borrowed
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
)
from numba.np.arrayobj import populate_array

TRIED = (0, 61), (0, 68)
"""The first and the last version whose insides are known."""


def known(version: str) -> bool:
    """Whether numba's insides are those that were tried; also where they have been renamed."""
    number = tuple(int(part) for part in version.split(".")[:2])
    hooks = hasattr(JITCodeLibrary, "_finalize_final_module") and hasattr(
        cpu_target.target_context.codegen(), "_library_class"
    )
    return TRIED[0] <= number <= TRIED[1] and hooks


KNOWN = known(numba.__version__)
LOST = (
    ""
    if KNOWN
    else f"numba {numba.__version__} works inside as none that was tried: compiling and steps take "
    "longer, and a run that compiles may differ in the last bits from later ones"
)
"""What is lost with this version, in a sentence; nothing where it is empty."""


class OwnCopies(JITCodeLibrary):
    """Machine code that calls its own copies of the kernels that it calls.

    numba links these copies weakly.  Each has been optimized where it stands and rounds in its own
    way, and which one runs would depend on what was loaded first: a run that compiles and the next
    one, from the cache, would differ in the last bits.
    """

    def _finalize_final_module(self) -> None:
        self._finalized = True  # as it is, but for the linkage: what callers link in stays weak
        self._get_module_for_linking()
        self._finalized = False
        for function in self._final_module.functions:
            if function.linkage is Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = Linkage.internal
        super()._finalize_final_module()


if KNOWN:
    type(cpu_target.target_context.codegen())._library_class = OwnCopies


class OneScope:
    """Stands for `copy` where numba copies the blocks of a kernel that it puts into another.

    It would copy with each block the scope that all blocks of a function are in, and with that
    every variable there is, which grows with the square of the length of a kernel.
    """

    @staticmethod
    def deepcopy(block: Any) -> Any:
        """A block whose scope is the same one."""
        return copy.deepcopy(block, {id(block.scope): block.scope})


if KNOWN:
    inline_closurecall.copy = OneScope  # type: ignore[assignment]


OPERATORS = frozenset(getattr(operator, name) for name in operator.__all__)
PLAIN = types.Number, types.Boolean, types.Array, types.BaseTuple
_find = types.functions.BaseFunction.get_call_type
_found: dict[Any, Any] = {}


def found_before(function: Any, context: Any, arguments: Any, named: Any) -> Any:
    """The kinds of arguments and result of a call; of an operator on plain kinds, looked for once.

    numba tries a dozen rules, for strings, lists and dates too, each time that it comes to a sum.
    """
    plain = function.typing_key in OPERATORS and not named
    if not plain or not all(isinstance(argument, PLAIN) for argument in arguments):
        return _find(function, context, arguments, named)
    asked = function, context, tuple(arguments)
    if asked not in _found:
        _found[asked] = _find(function, context, arguments, named)
    return _found[asked]


_go_through, _rename = ssa._run_ssa, ssa._run_block_rewrite
_names: dict[int, set[str]] = {}
"""What each block of the kernel that is worked at has named to begin with."""


def names_known(blocks: Any) -> Any:
    """The blocks of a kernel in which each variable is assigned once."""
    _names.clear()
    for label, block in blocks.items():
        variables = (variable for statement in block.body for variable in statement.list_vars())
        _names[label] = {variable.name for variable in variables}
    return _go_through(blocks)


def only_where_it_is_named(blocks: Any, states: Any, handler: Any) -> Any:
    """The blocks of a kernel with one variable renamed, in those that name it.

    numba goes through all statements for each variable that is assigned twice.
    """
    return {
        label: _rename({label: block}, states, handler)[label]
        if states["varname"] in _names[label]
        else block
        for label, block in blocks.items()
    }


if KNOWN:
    types.functions.BaseFunction.get_call_type = found_before  # type: ignore[assignment]
    ssa._run_ssa, ssa._run_block_rewrite = names_known, only_where_it_is_named


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        members: Any = kind
        parts = [
            _without_owner(context, builder, members[i], part)
            for i, part in enumerate(cgutils.unpack_tuple(builder, value))
        ]
        return context.make_tuple(builder, kind, parts)
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        return array._getvalue()
    return value


def _lend(typingctx: Any, arrays: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _without_owner(context, builder, signature.args[0], arguments[0])

    return arrays(arrays), codegen


def _as_it_is(arrays: Any) -> Any:
    return arrays


lent: Any = intrinsic(_lend) if KNOWN else numba.njit(_as_it_is)
"""`lent(x)` in a kernel: its argument x, array or tuple of these, whose holders are not counted.

Each time that compiled code takes an array out of a tuple or hands it on, it counts, atomically,
who holds it.  The caller holds the arguments of a kernel for as long as it runs.  What is lent must
not be returned.
"""


class InPlace(types.Type):
    """A named tuple that stands in memory, and is read a member at a time."""

    def __init__(self, members: Any):
        self.members = members
        super().__init__(f"InPlace({members})")


@register_model(InPlace)
class _InPlaceModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: InPlace):
        place = manager.lookup(kind.members).get_value_type().as_pointer()
        super().__init__(manager, kind, place)


@infer_getattr
class _InPlaceMember(AttributeTemplate):
    key = InPlace

    def generic_resolve(self, kind: InPlace, name: str) -> Any:  # type: ignore[override]
        members = kind.members
        return members[members.fields.index(name)] if name in members.fields else None


@lower_getattr_generic(InPlace)
def _member(context: Any, builder: Any, kind: InPlace, place: Any, name: str) -> Any:
    index = kind.members.fields.index(name)
    value = builder.load(cgutils.gep_inbounds(builder, place, 0, index))
    return impl_ret_borrowed(context, builder, kind.members[index], value)


def _put_in_place(typingctx: Any, members: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return cgutils.alloca_once_value(builder, arguments[0])

    return InPlace(members)(members), codegen


in_place: Any = intrinsic(_put_in_place)
"""`in_place(x)` in a kernel: the named tuple x, of which each use reads what it names.

A tuple is a value: compiled code copies all of it, hundreds of words where arrays are in tuples in
a tuple, each time that one member is used, and LLVM takes most of its time to be rid of the copies.
Members are values still.  It must not outlive the kernel.
"""


def _keep_from_writing(typingctx: Any, array: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return impl_ret_borrowed(context, builder, signature.return_type, arguments[0])

    return array.copy(readonly=True)(array), codegen


read_only: Any = intrinsic(_keep_from_writing)
"""`read_only(x)` in a kernel: the same array, not to be written to, as a solver wants a QP."""


def _in_rows(typingctx: Any, array: Any, rows: Any, columns: Any) -> Any:
    kind = array.copy(ndim=2)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = context.make_array(array)(context, builder, arguments[0])
        matrix = context.make_array(kind)(context, builder)
        width = vector.itemsize
        shape = [
            context.cast(builder, count, given, types.intp)
            for count, given in zip(arguments[1:], (rows, columns), strict=True)
        ]
        populate_array(
            matrix,
            data=vector.data,
            shape=shape,
            strides=[builder.mul(shape[1], width), width],
            itemsize=width,
            meminfo=vector.meminfo,
        )
        return impl_ret_borrowed(context, builder, kind, matrix._getvalue())

    return kind(array, rows, columns), codegen


in_rows: Any = intrinsic(_in_rows)
"""`in_rows(x, n, m)` in a kernel: x (n m,) as (n, m), in no time."""


def function_at(signature: Any) -> Any:
    """`function_at(signature)(address)` in a kernel: the compiled function at an address.

    Handed over as itself, its signature would be looked at, in Python, at every call.
    """
    kind = types.FunctionType(signature)

    def at(typingctx: Any, address: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            made = cgutils.create_struct_proxy(kind)(context, builder)
            first, *others = default_manager.lookup(kind)._fields
            setattr(made, first, builder.inttoptr(arguments[0], cgutils.voidptr_t))
            for name in others:
                setattr(made, name, cgutils.get_null_value(cgutils.voidptr_t))
            return made._getvalue()

        return kind(types.int64), codegen

    return intrinsic(at)


def take_literals_as_numbers(kernel: Any) -> Any:
    """`kernel`, which is compiled once for all whole numbers and truths.

    numba compiles a kernel once more for every constant that another one hands to it, be it the
    name of a row.
    """
    found = kernel.get_call_template

    def get_call_template(arguments: Any, named: Any) -> Any:
        named = {name: types.unliteral(kind) for name, kind in named.items()}
        return found(tuple(types.unliteral(kind) for kind in arguments), named)

    if KNOWN:
        kernel.get_call_template = get_call_template
    return kernel


def keep_nothing() -> None:
    """From now on this process keeps no machine code in files, as one that may not write them."""
    Cache.save_overload = lambda self, signature, data: None  # type: ignore[method-assign]
