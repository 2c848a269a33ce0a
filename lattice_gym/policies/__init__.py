"""What drives a worm: any callable from observation to action, played, scored, recorded and filmed."""
