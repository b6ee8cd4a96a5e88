"""`gaitway doctor` checks the settings, the machine, its confinement, the stores and the service."""
