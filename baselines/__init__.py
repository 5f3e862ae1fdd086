"""What is done with task and planners: learning, comparing, the paper's figures, pictures, a console."""
