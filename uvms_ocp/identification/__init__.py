"""A vehicle's own numbers, from its own recordings.

Data flows one way: ``recordings`` (what was measured) -> ``parameters`` (what may be identified, consistent whatever its
value) -> ``models`` (what the vehicle does with them, from the symbolic dynamics) -> ``methods`` (equation error, output
error) -> ``answers`` (how sure, what is not determined, what they predict). ``excitation`` goes the other way: from what is to be
learnt to commands that tell it.
"""
