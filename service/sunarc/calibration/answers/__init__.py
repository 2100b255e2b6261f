"""Answers of a calibration about a pixel, a direction, a map, an ensemble; needs the model and the optics, no fit."""
