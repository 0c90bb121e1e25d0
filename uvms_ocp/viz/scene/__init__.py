"""The run in three dimensions: one HTML page that works offline, drawn with meshcat but without its
server.
"""
