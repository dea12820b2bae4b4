"""Test bed for low-light 3D reconstruction: NOVA-GS, its rivals, and their score against the truth.

`open` and `frame` read finished folders, `run` and `study` make them.
"""

import lazy_loader

# Each name is imported when it is used: the command line answers before torch is loaded. The names: __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
