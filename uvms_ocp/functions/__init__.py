"""CasADi functions in, things to call out: compiled once into a cache, called through fixed memory."""

from uvms_ocp.functions.buffered import BufferedFunction as BufferedFunction
from uvms_ocp.functions.compile import compile_function as compile_function
from uvms_ocp.functions.compile import compile_library as compile_library
from uvms_ocp.functions.compile import external_function as external_function
from uvms_ocp.functions.compile import has_compiler as has_compiler
