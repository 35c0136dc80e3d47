"""What a vehicle's own dives say of how its DVL is built in: where it sits, how it is turned, how late and how long it
reads."""
