"""A measurement and a plan, or a problem over a horizon, in; thrust and torque along the newest plan out."""
