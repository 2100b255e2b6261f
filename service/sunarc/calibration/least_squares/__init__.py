"""The nonlinear least-squares problem: residuals, Jacobian, priors, Levenberg-Marquardt solver."""
