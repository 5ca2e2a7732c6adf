"""What a Rerun viewer shows of a recording: live and afterwards, from the same records, by the same code.

:class:`recorder.viewer.translator.Translator` gives each record to both parts of the picture:
:class:`recorder.viewer.scene_view.SceneView`, bodies in the scene, marks of targets and answers, plots; and
:class:`recorder.viewer.log_view.LogView`, log lines, tables, queries, timeline and graph of tasks.
"""
