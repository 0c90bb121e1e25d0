"""Other formats of robot files, each read as the URDF that says the same: SDF, MJCF, xacro."""
