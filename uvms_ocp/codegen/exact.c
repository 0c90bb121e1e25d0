/* Every operation below rounds once, as it was recorded: no fused multiplication, no algebra on rounded numbers, no wider
   registers, whatever the command line says. GCC fuses in vectors even where contraction is off (-O3 -march=native), so these
   are not made of straight code, nor of loops on RISC-V. */
#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || \
    (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math, -Ofast and their parts give other numbers than were recorded; build without them"
#endif
#if defined(__FLT_EVAL_METHOD__) && (__FLT_EVAL_METHOD__ == 2 || __FLT_EVAL_METHOD__ < 0)
#error "registers of 80 bits give other numbers than were recorded; build with -msse2 -mfpmath=sse"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off", "no-tree-slp-vectorize")
#if defined(__riscv)
#pragma GCC optimize("no-tree-vectorize")
#endif
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif
