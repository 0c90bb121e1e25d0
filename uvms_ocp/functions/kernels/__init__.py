"""Kernels: functions of numbers, written once in Python, which run as C where there is a compiler.

What branches, loops and remembers at every tick is written as a kernel; what is smooth is a CasADi expression. A kernel is a
function at the top level of a module. Its parameters are annotated with ``float``, ``int``, ``bool``, `Vector` or a `Layout`; its
body keeps to assignments, ``if``, ``for`` over ``range``, ``while``, ``return``, arithmetic, comparisons, ``min``, ``max``,
``abs``, ``len`` of an array in a layout, `zeros`, functions of ``math`` and other kernels. Constants are numbers and members of
integer enumerations of its module. A CasADi function is a field of a layout (`Smooth`), called with vectors and layouts of them,
and so is a question to Python (`Ask`), for what has no other form. A local variable keeps the type that it has first. Layouts and
vectors are changed in place.

Python and C give the same bits as long as nothing is divided by zero, taken the root of below zero or made an integer out of
range: there Python raises, and C goes on. Kernels guard against it, and multiply where they would take a power.
"""
