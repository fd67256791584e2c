"""What each command imports first. SIGINT then ends the program without a traceback, and matrices use one thread.

Python's own handler of SIGINT raises KeyboardInterrupt anywhere, and during an import that prints a traceback. Only the
files of `bin/` import this module, with SIGINT blocked.
"""

import gc
import os
import signal

# Before numpy is imported. Matrices are small: more threads only wait for each other, which doubles the processor time
# of `msp-lab gap` on a busy computer, delays the service's start by 25 ms, and changes last digits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Imports produce no garbage, and looking for it takes a twentieth of their time: a command enables it as it begins.
gc.disable()
signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
