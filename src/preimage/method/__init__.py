"""The paper: training, prediction error, error regression, planning, one-step prediction."""
