cp -r $FLOWN/. .
