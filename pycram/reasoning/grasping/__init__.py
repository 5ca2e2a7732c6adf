"""How hands take objects, and where objects come to rest."""
