"""preimage: imagine the way to a goal before moving (P-DVMRNN, Choi, Matsumoto, Jung and Tani 2018)."""
