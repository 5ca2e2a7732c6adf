"""The view of a recording in Rerun. Live and afterwards, the same code makes it from the same records.

:class:`recorder.viewer.translator.Translator` passes each record to the parts of the view.
"""
