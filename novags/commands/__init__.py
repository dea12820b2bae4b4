"""The commands of `novags`, one function each. Thin: arguments become a configuration, the test bed does the work."""
