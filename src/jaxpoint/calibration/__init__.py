"""From tracks to a calibration: factorisation, upgrade, adjustment, alignment."""
