from .buffered import BufferedFunction as BufferedFunction
from .compile import (
    compile_function as compile_function,
    compile_library as compile_library,
    external_function as external_function,
    has_compiler as has_compiler,
)
