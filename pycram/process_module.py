"""Process modules, under the names of the thesis (sections 4.7 to 4.9)."""

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

register_default(SIMULATED, default_modules)  # imported here, because the modules import the class that selects them
register_default(CONTINUOUS, partial(default_modules, IN_SIMULATED_TIME))
