"""All methods on frozen scenes, judged by the certifier."""
