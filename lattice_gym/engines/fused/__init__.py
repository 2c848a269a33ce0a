"""The compiled engine: worms side by side in lanes, packs and threads."""
