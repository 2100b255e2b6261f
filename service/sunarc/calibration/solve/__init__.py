"""The nonlinear least-squares problem: priors, residuals and their rows, bins, Levenberg-Marquardt."""
