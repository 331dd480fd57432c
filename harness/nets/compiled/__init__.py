"""Networks over columns in compiled C++, several times as fast as Dr.Jit's on a CPU.

Built by the machine's own compiler when first needed and kept in the cache folder. Where there is
no compiler, or one of the conditions in :func:`harness.nets.compiled.network.usable` does not hold,
Dr.Jit's cooperative vectors do the same work.
"""
