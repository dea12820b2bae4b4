"""The stages: folder in, folder out. `ledger.stage.run_stage` makes them resumable and keeps finished work.

`stale` names files elsewhere that describe an earlier result; they are removed together with it.
"""

import lazy_loader

# A stage is imported when it is used: rendering needs no torch, whose import takes seconds. The names: __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
