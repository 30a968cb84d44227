"""Work for many processes on one or more machines, by way of dask.distributed: connected, handed out, never lost.

Imports anything but `cli`.
"""
