"""What a Rerun viewer shows of a recording: live and afterwards, from the same records, by the same code.

:class:`recorder.viewer.translator.Translator` gives each record to all that show something of it: scene, marks and
curves; log, tables, query, tasks over time and task tree. They send rows through :mod:`recorder.viewer.rerun_stream`.
"""
