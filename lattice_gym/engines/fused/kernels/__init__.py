"""Compiled code of the fused engine, one subject a file; `step` has the time step, and calls the laws.

What is compiled may call and read only what stands in this folder, numpy and numba: the cache of machine code is as old
as these files, see `compiling`.
"""
