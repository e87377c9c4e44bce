"""hil: measure a feed axis, correct it, prove it, and trace what is left to the effect the model lacks.

Scripts use `hil.open` and the other names of `hil.script.names` (`hil help api`), which are imported with the first use of one.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hil.script.names import *  # noqa: F403
else:

    def __getattr__(name: str) -> object:
        if name.startswith("_"):
            raise AttributeError(f"module 'hil' has no attribute {name!r}")
        from hil.script import names  # noqa: PLC0415

        if name not in names.__all__:
            raise AttributeError(f"module 'hil' has no attribute {name!r}, expected one of {', '.join(names.__all__)}")
        return getattr(names, name)
