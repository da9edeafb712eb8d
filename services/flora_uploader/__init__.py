"""flora-uploader: every file of record to the NAS, verified."""
