"""Declare the memory of kernels: numbers, arrays, parts, CasADi functions and callbacks, alike in
Python and in C.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, MutableSequence
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Annotated, Any, TypeAlias, TypeVar, cast, get_args, get_origin, get_type_hints
from weakref import WeakKeyDictionary, WeakValueDictionary

import casadi as ca
import numpy as np

from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.compile import compiled_symbol
from uvms_ocp.errors import InvalidInput

_FUNCTIONS = WeakKeyDictionary[Any, tuple[str, ...]]()
"""Names of the fields of each type of a structure that hold functions."""
_LIVING = WeakValueDictionary[tuple[Any, tuple[tuple[str, Any], ...]], type[ctypes.Structure]]()
"""Types of structures that are in use, by layout and sizes."""
_CALL = ctypes.CFUNCTYPE(ctypes.c_int, *(ctypes.c_void_p,) * 4, ctypes.c_int)
"""Type of machine code that CasADi writes: of arguments, results, work memory and its number."""
_NOTHING = ca.Function("ask", [], [])
"""Function without arguments, in whose place a callback is called."""
_buffered = lru_cache(maxsize=96)(BufferedFunction)

Vector: TypeAlias = MutableSequence[float]
"""A parameter of a kernel: numbers that it reads or changes in place."""

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
WIDE: set[Callable[..., Any]] = set()
"""Kernels that are marked by `wide`."""
NUMBERS: dict[Any, Any] = {float: ctypes.c_double, int: ctypes.c_int, bool: ctypes.c_int}
"""Types of numbers, in Python and in C."""


class Layout:
    """Base of classes that only declare: ``float``, ``int``, ``bool``, sized arrays of them,
    layouts, functions and callbacks.

    ``structure_of(Class, n_joints=4)`` is the type whose instances kernels work on; all of it is
    zero at first.
    """


@dataclass(frozen=True, slots=True, init=False)
class Sized:
    """Sizes of an array in a layout, ``Annotated[Vector, Sized(3, "n")]``: numbers, or names that
    `structure_of` is given.
    """

    sizes: tuple[int | str, ...]

    def __init__(self, *sizes: int | str) -> None:
        object.__setattr__(self, "sizes", sizes)


Memory = TypeVar("Memory", bound=Layout)
NOT_COUNTED = -1
"""Size that a set of dimensions has a name for, and that is not known yet."""


def structure_of(
    layout: type[Memory], dimensions: Any = None, **sizes: int | ca.Function | type[Layout]
) -> type[Memory]:
    """Return the type of a layout in memory, with the sizes that its arrays and those of its parts
    are declared with, and functions.

    It is a structure of ctypes with the fields of the layout, and typed as the layout itself.

    dimensions: whose attributes are sizes by name, `NOT_COUNTED` as if it were not there; sizes:
    others, functions by the name of their field, and the type of a part that is made already by
    that of its field. Raises `InvalidInput` for a size or function that is in neither, and a field
    of another type.
    """
    key: Any = layout
    names = _names(key, frozenset(sizes))
    read = {}
    for name in sorted(names):
        if name in sizes:
            read[name] = sizes[name]
        elif getattr(dimensions, name, NOT_COUNTED) != NOT_COUNTED:
            read[name] = getattr(dimensions, name)
    return cast(type[Memory], _structure(key, tuple(read.items())))


@lru_cache(maxsize=160)
def _names(layout: Any, made: frozenset[str]) -> frozenset[str]:
    """Return the names of all sizes and functions that a layout and its parts are declared with.

    made: names that are given, among which those of parts may be, whose own names do not count.
    """
    names = set[str]()
    for field_name, hint in get_type_hints(layout, include_extras=True).items():
        item = hint if _item(hint) is None else _item(hint)
        if _item(hint) is not None:
            names |= {size for size in _declared(hint) if isinstance(size, str)}
        is_part = isinstance(item, type) and issubclass(item, Layout)
        if hint is FunctionField or (is_part and field_name in made):
            names.add(field_name)
        elif is_part:
            names |= _names(item, made)
    return frozenset(names)


@lru_cache(maxsize=80)
def _structure(layout: Any, sizes: tuple[tuple[str, Any], ...]) -> type[ctypes.Structure]:
    """Return the type of a layout with these sizes: one, for as long as any memory has it, so that
    memories that were made at different times fit into one program.
    """
    structure = _LIVING.get((layout, sizes))
    if structure is None:
        structure = _made_structure(layout, sizes)
        _LIVING[layout, sizes] = structure
    return structure


def _made_structure(layout: Any, sizes: tuple[tuple[str, Any], ...]) -> type[ctypes.Structure]:
    known_sizes = dict(sizes)
    fields = list[tuple[str, Any]]()
    arrays = dict[str, tuple[int, ...]]()
    for name, hint in get_type_hints(layout, include_extras=True).items():
        fields.append((name, _field(f"{layout.__name__}.{name}", hint, known_sizes)))
        lengths = _lengths(hint, known_sizes)
        if lengths:
            arrays[name] = lengths
    body = {"__slots__": (), "_fields_": fields, "__doc__": layout.__doc__, "_arrays_": arrays}
    return type(layout.__name__, (ctypes.Structure,), body)


def _lengths(hint: Any, sizes: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the sizes of an array of numbers, which may be 0; nothing for any other field."""
    if _item(hint) not in NUMBERS:
        return ()
    return tuple(_length(size, sizes) for size in _declared(hint))


def _declared(hint: Any) -> tuple[int | str, ...]:
    """Return the sizes with which a field is annotated."""
    sized: Sized = get_args(hint)[1]
    return sized.sizes


def _length(size: int | str, sizes: Mapping[str, int]) -> int:
    """Return a size that is a number already, or that of its name."""
    if isinstance(size, str):
        return sizes[size]
    return size


def _field(name: str, hint: Any, sizes: Mapping[str, Any]) -> Any:
    """Return the type in ctypes of a field; name: of it and its layout, ``Layout.field``."""
    if hint in NUMBERS:
        return NUMBERS[hint]
    field_name = name.rpartition(".")[2]
    if isinstance(hint, type) and issubclass(hint, Layout):
        return sizes.get(field_name) or structure_of(hint, **sizes)
    if hint is CallbackField:
        return CallbackStructure
    if hint is FunctionField:
        return function_structure(_required(name, field_name, sizes))
    item = _item(hint)
    if item is None:
        raise InvalidInput(
            f"{name} is {hint}; give float, int, bool, a Layout, or a sequence of one of them with"
            " its Sized"
        )
    kind = _field(name, item, sizes)
    for size in reversed(_declared(hint)):
        if isinstance(size, str):
            size = _required(name, size, sizes)
        kind = kind * max(1, size)  # C knows no empty array
    return kind


def _required(name: str, size_name: str, sizes: Mapping[str, Any]) -> Any:
    """Return a size or function by its name; raise `InvalidInput` where a field lacks it."""
    if size_name not in sizes:
        raise InvalidInput(
            f"{name} needs {size_name!r}, which is not given; given: {sorted(sizes)}"
        )
    return sizes[size_name]


def _item(hint: Any) -> Any:
    """Return the type of the entries of an array, however many dimensions it has; `None` for
    anything else.

    What may be an expression elsewhere, and is annotated with Any, is numbers here.
    """
    if get_origin(hint) is not Annotated or not isinstance(get_args(hint)[1], Sized):
        return None
    item = get_args(hint)[0]
    while get_origin(item) is not None:
        item = get_args(item)[0]
    if item is Any:
        return float
    return item


def declared_sizes(layout: type[Layout], dimensions: Any) -> dict[str, int]:
    """Count the entries of each array of one dimension in a layout of nothing else, by name;
    dimensions: as for `structure_of`.
    """
    declared = dict[str, int]()
    for name, hint in get_type_hints(layout, include_extras=True).items():
        length, *_ = _declared(hint)
        declared[name] = length if isinstance(length, int) else getattr(dimensions, length)
    return declared


# Words of kernels.


def zeros(n: int) -> list[float]:
    """Make a local array of a kernel: n numbers, which is a constant, or the `len` of an array in a
    layout.
    """
    return [0.0] * n


def wide(kernel: Kernel) -> Kernel:
    """Mark a kernel for wider registers where the processor has them: for long loops. The numbers
    are the same.
    """
    WIDE.add(kernel)
    return kernel


# Functions of CasADi in a memory.


class FunctionField:
    """A field of a layout: a function that kernels call as ``m.levels(q, v, J, lower)``, what it
    reads first, then what it fills.

    ``structure_of(Memory, levels=function)`` says which. Every argument is a vector of its own
    size, column after column, or a layout of nothing but arrays of numbers, which is their column.
    A number is a vector of one to read; None is zeros to read, or nothing to fill.
    """

    def __call__(self, *vectors: Any) -> None:
        """Declare the call in a kernel."""


class FunctionStructure(ctypes.Structure):
    """Structure of one function: its address, and its work memory."""

    __slots__ = ()
    function: ca.Function
    """CasADi function that is called."""

    def __call__(self, *vectors: Any) -> None:
        """Call the function without a compiler, as C does."""
        call = _buffered(self.function)
        n_in = self.function.n_in()
        arguments = list[np.ndarray]()
        for i, vector in enumerate(vectors[:n_in]):
            arguments.append(_argument(vector, self.function.size_in(i)))
        results = call(*arguments)
        for target, values in zip(vectors[n_in:], results, strict=True):
            if target is not None:
                _numbers(target)[: values.size] = values.ravel(order="F")


def _argument(vector: Any, size: tuple[int, int]) -> np.ndarray:
    """Return the first numbers of a vector as a matrix of this size; zeros for None."""
    if vector is None:
        return np.zeros(size)
    n_rows, n_columns = size
    return _numbers(vector).ravel()[: n_rows * n_columns].reshape(size, order="F")


def _numbers(vector: Any) -> np.ndarray:
    """Return an array of NumPy on the memory of a structure or array of ctypes, else a copy."""
    if isinstance(vector, ctypes.Structure):
        return column_view(vector)
    if isinstance(vector, ctypes.Array):
        return np.ctypeslib.as_array(vector)
    return np.array(vector, dtype=float)


@lru_cache(maxsize=48)
def function_structure(function: ca.Function) -> type[FunctionStructure]:
    """Return the type of the field. Raises `InvalidInput` for a function with structural zeros
    among what it takes or gives.
    """
    dense_inputs = [function.sparsity_in(i).is_dense() for i in range(function.n_in())]
    dense_outputs = [function.sparsity_out(i).is_dense() for i in range(function.n_out())]
    if not all(dense_inputs + dense_outputs):
        raise InvalidInput(f"{function.name()} has sparse arguments; make them dense")
    n_arg, n_res, n_iw, n_w = work_sizes(function)
    fields = (
        ("call", ctypes.c_void_p),
        ("arg", ctypes.c_void_p * n_arg),
        ("res", ctypes.c_void_p * n_res),
        ("iw", ctypes.c_longlong * n_iw),
        ("w", ctypes.c_double * n_w),
    )
    name = f"Smooth_{function.name()}_{n_arg}_{n_res}_{n_iw}_{n_w}"
    body = {"__slots__": (), "_fields_": fields, "function": function}
    return type(name, (FunctionStructure,), body)


def work_sizes(function: ca.Function) -> tuple[int, int, int, int]:
    """Return the sizes of the memory of a call: pointers to arguments, pointers to results, whole
    numbers, numbers.
    """
    return (
        max(1, function.sz_arg()),
        max(1, function.sz_res()),
        max(1, function.sz_iw()),
        max(1, function.sz_w()),
    )


def connect(memory: Layout) -> bool:
    """Give the functions in `memory` the addresses of their machine code; false where one of them
    cannot be compiled.
    """
    are_compiled = True
    for part in functions_in(memory):
        if part.function.n_out():
            part.call = compiled_symbol(part.function)
            are_compiled &= part.call is not None
    return are_compiled


def functions_in(memory: Any) -> Iterator[FunctionStructure]:
    """Yield the functions of a memory, of its parts, and of arrays of parts."""
    if isinstance(memory, FunctionStructure):
        yield memory
    elif isinstance(memory, ctypes.Structure):
        for name in _with_functions(type(memory)):
            yield from functions_in(getattr(memory, name))
    elif isinstance(memory, ctypes.Array) and _with_functions(type(memory)):
        for part in memory:
            yield from functions_in(part)


def _with_functions(kind: Any) -> tuple[str, ...]:
    """Return the names of the fields of a structure that hold functions; of an array those of its
    entries. They are found once per type.
    """
    if kind in _FUNCTIONS:
        return _FUNCTIONS[kind]
    names: tuple[str, ...] = ()
    if issubclass(kind, ctypes.Array):
        names = _with_functions(kind._type_)
    elif issubclass(kind, FunctionStructure):
        names = ("",)
    else:
        for name, field_kind, *_ in getattr(kind, "_fields_", ()):
            if _with_functions(field_kind):
                names = (*names, name)
    _FUNCTIONS[kind] = names
    return names


# Calls of Python from a kernel.


class CallbackField:
    """Field of a layout: a call of Python, in kernels ``m.ask()``, once a `CallbackBinding` is
    bound to the memory.
    """

    def __call__(self) -> None:
        """Declare the call in a kernel."""


class CallbackStructure(function_structure(_NOTHING)):  # type: ignore[misc]
    """Callback in memory: the address of a function without arguments, where a `FunctionField` has
    its machine code.
    """

    __slots__ = ()

    def __call__(self) -> None:
        """Call it without a compiler, as C does."""
        _CALL(self.call)(None, None, None, None, 0)


class CallbackBinding:
    """The Python function that answers a question in a memory, for as long as this lives."""

    def __init__(self, question: Any, function: Callable[[], None]) -> None:
        self._function = function
        self._error: BaseException | None = None
        self._called = _CALL(self._call)
        question.call = ctypes.cast(self._called, ctypes.c_void_p).value

    def check(self) -> None:
        """Raise what the function has raised, which kernels do not."""
        error = self._error
        self._error = None
        if error is not None:
            raise error

    def _call(self, *nothing: Any) -> int:
        try:
            self._function()
        except BaseException as error:
            self._error = error
            return 1
        return 0


# Numbers and arrays of a memory, from Python.


def assign(memory: Layout, **values: Any) -> None:
    """Set numbers in a memory by their names, and arrays from their first entry on; of one number,
    all entries.
    """
    for name, value in values.items():
        field = getattr(memory, name)
        if isinstance(field, ctypes.Array):
            array = np.asarray(value)
            view(field)[_first_entries(array.shape)] = array
        else:
            setattr(memory, name, value)


def arrays_of(memory: Layout) -> Any:
    """Return the arrays of numbers in a memory: under their names, on the same memory, of the sizes
    that they were declared with.
    """
    sizes: dict[str, tuple[int, ...]] = getattr(memory, "_arrays_")  # noqa: B009
    arrays = SimpleNamespace()
    for name, shape in sizes.items():
        array = view(getattr(memory, name))
        setattr(arrays, name, array[_first_entries(shape)])
    return arrays


def _first_entries(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Return the index of as many entries as `shape` has, in each dimension."""
    return tuple(slice(size) for size in shape)


def column_view(layout: Any) -> np.ndarray:
    """Return a layout of nothing but arrays of numbers as one array of them (n,) [any] on the same
    memory.
    """
    n = ctypes.sizeof(layout) // ctypes.sizeof(ctypes.c_double)
    return np.ctypeslib.as_array((ctypes.c_double * n).from_buffer(layout))


def doubles(values: np.ndarray) -> Any:
    """Return values (n,) [any] as a vector of a kernel, on memory of their own."""
    return (ctypes.c_double * len(values))(*values.tolist())


def view(array: Any) -> np.ndarray:
    """Return an array of a structure as one of NumPy on the same memory; make it once, as that
    takes long.
    """
    return np.ctypeslib.as_array(array)


def number_in_memory(memory: Layout, name: str) -> np.ndarray:
    """Return a number of a structure as an array () of NumPy on the same memory."""
    structure: Any = type(memory)
    array_type = dict(structure._fields_)[name] * 1
    place = array_type.from_buffer(memory, getattr(structure, name).offset)
    return view(place).reshape(())
