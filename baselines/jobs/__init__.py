"""Work on several processes or a cluster, and files that are whole or not there."""
