"""From records to states: the fold, states as data, and how two of them differ."""
