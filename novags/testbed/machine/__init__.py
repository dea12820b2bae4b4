"""The machine and what it has: devices, memory, versions, and what of them works."""
