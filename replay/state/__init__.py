"""States of worlds: the fold of records, states as data, and checks of records."""
