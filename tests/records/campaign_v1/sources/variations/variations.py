from uvms_ocp.campaign import Normal, Variation

variations = [Variation("start.x", Normal(0.0, 0.1))]
