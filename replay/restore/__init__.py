"""From a recording back to a live world, or to a picture of it. This room and those above import the executor."""
