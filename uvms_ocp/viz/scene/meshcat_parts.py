"""The parts of meshcat that scenes use, imported without the deprecation warning that its unused server raises."""

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from meshcat import geometry as geometry
    from meshcat import viewer_assets_path as viewer_assets_path
    from meshcat.animation import Animation as Animation
    from meshcat.animation import AnimationClip as AnimationClip
    from meshcat.animation import AnimationTrack as AnimationTrack
    from meshcat.commands import SetAnimation as SetAnimation
    from meshcat.path import Path as ScenePath
    from meshcat.visualizer import Visualizer as Visualizer

__all__ = [
    "Animation",
    "AnimationClip",
    "AnimationTrack",
    "ScenePath",
    "SetAnimation",
    "Visualizer",
    "geometry",
    "viewer_assets_path",
]
