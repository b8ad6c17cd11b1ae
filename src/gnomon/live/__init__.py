"""Guided capture: samples are recorded as they arrive, and a person is told what to do next.

source -> recorder -> coach -> status line and page -> stop -> the ordinary command on the ordinary folder
"""
