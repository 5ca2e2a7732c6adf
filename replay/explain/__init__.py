"""Why a plan failed: functions from recordings to frozen data, with its words."""
