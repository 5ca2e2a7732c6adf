"""From a recording back to a live world. This room and those above need the executor."""
