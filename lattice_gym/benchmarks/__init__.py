"""Reports: what the engines reach, measured by `python -m lattice_gym.benchmarks NAME`.

Each writes a table (Markdown), its figures (JSON) and pictures (PNG) into one folder, with a footer that says on what
machine, with which versions and by which command they were made.
"""
