"""What moved between results: `cells` lays the tables of two results side by side, `comparison` many dives of them."""
