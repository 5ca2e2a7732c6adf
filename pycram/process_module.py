"""Process modules, under the names of the thesis (4.7-4.9); PyCRAM's own serve two execution environments."""

from functools import partial

from pycram.motions.execution import IN_SIMULATED_TIME
from pycram.motions.modules import default_modules
from pycram.motions.process_module import (
    CONTINUOUS,
    SIMULATED,
    NoDescription,
    NoProcessModule,
    ProcessModule,
    execution_environment,
    register,
    register_default,
)
from pycram.motions.resources import Resources

__all__ = ["NoDescription", "NoProcessModule", "ProcessModule", "Resources", "execution_environment", "register"]

register_default(SIMULATED, default_modules)  # the modules are built on the class that chooses among them
register_default(CONTINUOUS, partial(default_modules, IN_SIMULATED_TIME))
