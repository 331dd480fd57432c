"""Samplers over columns: one Dr.Jit array per input, the whole sampler one fused kernel.

A network of width 32 is too small for a matrix library: torch spends its time moving
activations through memory. Dr.Jit keeps a row's activations in registers and runs the
network, the warp and the density as one loop over SIMD packets, on CPU (LLVM) and CUDA.
"""
