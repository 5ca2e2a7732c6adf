"""The view of a recording in Rerun: the same code shows recordings live and afterwards."""
