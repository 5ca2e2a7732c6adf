"""Process modules, under the names of the thesis (4.7-4.9); PyCRAM's own serve the simulated environment."""

from pycram.motions.modules import default_modules
from pycram.motions.process_module import (
    SIMULATED,
    NoProcessModule,
    ProcessModule,
    execution_environment,
    register,
    serve,
)

__all__ = ["NoProcessModule", "ProcessModule", "execution_environment", "register"]

serve(SIMULATED, default_modules)  # the modules are built on the class that chooses among them: the face knows both
