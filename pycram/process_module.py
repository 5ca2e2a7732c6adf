"""Process modules, under the names of the thesis (4.7-4.9)."""

from pycram.motions.process_module import NoProcessModule, ProcessModule, execution_environment, register

__all__ = ["NoProcessModule", "ProcessModule", "execution_environment", "register"]
