"""The parts of `mutation_check.py`: rules of mistakes, mutants of a source, tests that reach them, verdicts."""
