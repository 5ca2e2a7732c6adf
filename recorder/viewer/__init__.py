"""The view of a recording in Rerun, live and afterwards: from the same records, by the same code.

:class:`recorder.viewer.translator.Translator` gives each record to all parts that show some of it.
"""
