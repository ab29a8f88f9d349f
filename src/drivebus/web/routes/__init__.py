"""Handlers of the operations of this process, and the files of the page."""
