"""The view of a recording in Rerun, live and afterwards, from the same records and by the same code.

:class:`recorder.viewer.translator.Translator` passes each record to the parts of the view.
"""
