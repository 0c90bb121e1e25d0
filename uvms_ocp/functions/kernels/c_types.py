"""Types of what a kernel computes with, as C has them."""

from __future__ import annotations

import ast
import ctypes
from dataclasses import dataclass
from typing import Any

from uvms_ocp.exceptions import InvalidInput


def kernel_error(node: ast.AST, why: str) -> InvalidInput:
    """That something in a function keeps it from being a kernel, and where."""
    return InvalidInput(f"line {getattr(node, 'lineno', 0)}: {ast.unparse(node)} {why}")


@dataclass(frozen=True, slots=True)
class CType:
    """A type by its name in C: "double", "int" or that of a structure, which is passed by pointer, or an array of one of them."""

    name: str
    sizes: tuple[int, ...] = ()
    """[-] of an array; 0 where it is unknown, as of a parameter."""
    structure: Any = None
    """The type in ctypes, of a structure."""

    @property
    def is_number(self) -> bool:
        """Rather than an array or a structure."""
        return not self.sizes and self.structure is None

    def entry(self) -> CType:
        """Of an array."""
        return CType(self.name, self.sizes[1:], self.structure)

    def declared(self, name: str) -> str:
        """A declaration of `name`."""
        if self.sizes == (0,):
            return f"{self.name} *{name}"
        if self.structure is not None and not self.sizes:
            return f"{self.name} *{name}"
        return f"{self.name} {name}{''.join(f'[{size}]' for size in self.sizes)}"


DOUBLE, INT, NOTHING = CType("double"), CType("int"), CType("void")
VECTOR = CType("double", (0,))


def of_ctypes(kind: Any) -> CType:
    """Of a field of a structure."""
    sizes = []
    while issubclass(kind, ctypes.Array):
        sizes.append(kind._length_)
        kind = kind._type_
    if issubclass(kind, ctypes.Structure):
        return CType(kind.__name__, tuple(sizes), kind)
    return CType("double" if kind is ctypes.c_double else "int", tuple(sizes))


def field_of(owner: CType, name: str) -> CType:
    """Of a field of a structure. Raises `InvalidInput` where it has none of that name."""
    fields = dict(owner.structure._fields_)
    if name not in fields:
        raise InvalidInput(f"{owner.name} has no field {name!r}; it has {', '.join(fields)}")
    return of_ctypes(fields[name])


def column_size(kind: CType) -> int:
    """Numbers [-] of a structure of nothing else, which are one after the other; 0 of any other type."""
    if kind.structure is None or kind.sizes:
        return 0
    fields = [of_ctypes(item[1]) for item in kind.structure._fields_]
    alone = all(item.name == "double" for item in fields)
    return ctypes.sizeof(kind.structure) // ctypes.sizeof(ctypes.c_double) if alone else 0
