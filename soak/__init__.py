"""What holds only if it is tried very often: wide random scenes, long runs, damaged files, interruptions."""
