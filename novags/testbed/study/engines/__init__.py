"""Where tasks are done. `local`: worker processes on this machine."""
