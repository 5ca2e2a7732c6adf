"""Properties: statements about the states of a run, such as ``never contact(pr2, kitchen)``.

The same code checks a recording and watches a running plan (docs/reference/properties.md).
"""

from recorder.properties.expressions import BadProperty
from recorder.properties.language import Property, parse, parse_file
from recorder.properties.monitor import Monitor, PropertyVerdict, Violation

__all__ = ["BadProperty", "Monitor", "Property", "PropertyVerdict", "Violation", "parse", "parse_file"]
