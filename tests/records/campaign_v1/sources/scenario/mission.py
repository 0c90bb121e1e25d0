import uvms_ocp as uo


def scenario(**options):
    return uo.scenarios.reach(**{"plant": "kinematic", "duration": 0.3, "dt": 0.02, **options})
