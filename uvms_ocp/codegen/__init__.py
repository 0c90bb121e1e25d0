"""CasADi functions and kernels, compiled once into a cache and called through fixed memory."""

from uvms_ocp.codegen.buffered import BufferedFunction as BufferedFunction
from uvms_ocp.codegen.compile import (
    compile_function as compile_function,
    compile_library as compile_library,
    external_function as external_function,
    has_compiler as has_compiler,
)
