"""`msp-range doctor`: from the bus to the autopilot, what is right, wrong or unknown, and what to do about it.

Each step gets what it examines as arguments: the computer's files below a root folder, a bus, a transport. So each
mistake of a user is tested with the files that it leaves, an emulated bus and a real link.
"""
