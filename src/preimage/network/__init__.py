"""The P-DVMRNN: layers, codes, intentions. It knows no data, no robot and no plan."""
