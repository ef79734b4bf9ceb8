"""Which terms a sensor model lacks, by photon transfer and dark variance."""
