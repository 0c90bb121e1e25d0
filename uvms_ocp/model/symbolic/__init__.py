"""A Pinocchio model in, its kinematics and dynamics as CasADi expressions out."""
