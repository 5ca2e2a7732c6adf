"""Why a plan failed: one finder for each kind of cause, and the explanation that they are part of."""
