"""In: recordings of a vehicle that moves its arm in a pool. Out: how well its simulated attitude
follows.
"""
