"""JSON documents of a calibration and of a type of lens: values are converted here, at the edge, and nowhere else."""
