"""What the processes of a topology have written: tables of activations and messages, and what these show."""
