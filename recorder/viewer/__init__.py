"""What a Rerun viewer shows of a recording: live and afterwards, from the same records, by the same code.

:class:`recorder.viewer.translator.Translator` takes records one by one and gives each to the parts of the picture:
bodies in the scene, marks of targets and answers, lanes and graph of tasks, log lines, plots, tables.
"""
