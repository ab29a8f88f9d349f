"""The plant as others see it: REST and WebSocket, each over ``PlantClient``; they never meet."""
