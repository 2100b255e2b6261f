"""Laboratory: the simulator, the paper's studies and the benchmark."""
