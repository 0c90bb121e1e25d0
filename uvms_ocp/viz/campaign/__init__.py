"""Figures and the page of a campaign. In: its report and table as plain values. Out: PNG, HTML."""
