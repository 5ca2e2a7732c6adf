"""Process modules, under the names of the thesis (4.7-4.9); PyCRAM's own serve the simulated environment."""

from pycram.motions.environments import (
    SIMULATED,
    NoProcessModule,
    execution_environment,
    register,
    register_default,
)
from pycram.motions.modules import default_modules
from pycram.motions.process_module import ProcessModule
from pycram.motions.resources import Resources

__all__ = ["NoProcessModule", "ProcessModule", "Resources", "execution_environment", "register"]

register_default(SIMULATED, default_modules)  # the modules are built on the class that chooses among them
