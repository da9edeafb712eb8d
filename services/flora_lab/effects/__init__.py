"""Effects that a simulator may lack: the catalogue that `flora-lab diagnose` names causes from."""
