"""The checks that claims of the manifest name: plain NumPy, one file per subject."""
