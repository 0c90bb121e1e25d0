"""In: a scenario. Out: a page for the browsers of this machine that shows its run while it goes on."""

from uvms_ocp.live.view import live as live
