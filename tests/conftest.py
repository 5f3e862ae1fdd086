"""A job in the background ignores Ctrl-C, and so would all that it starts; some tests send it on purpose."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
