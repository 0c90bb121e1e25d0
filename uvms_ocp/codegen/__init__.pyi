from .buffered import BufferedFunction as BufferedFunction
from .c_compiler import has_compiler as has_compiler
from .compile import (
    compile_function as compile_function,
    external_function as external_function,
)
from .libraries import compile_library as compile_library
